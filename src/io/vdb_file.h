// A .vdb file with a point grid: its points and their values, and the same file again with more values. Hides what reads and what
// writes it from point_file.cpp.
#pragma once

#include "io/byte_source.h"
#include "util/cancel.h"
#include "vdb_nns/particle_view.h"
#include "vdb_nns/point_file.h"

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace vdb_nns {

class VdbFile {
public:
    // Reads the chosen grid as PointFile::read() does, and fills in what the format says of it: all but points,
    // nonfinite, bbox and transform. Throws CapacityError where its points take more than `allowedBytes`.
    // `tile`: that alone.
    VdbFile(const ByteSource& file, const std::string& grid, const std::optional<TileOfFile>& tile,
            std::uint64_t allowedBytes, const CancelCheck& cancel, PointFileInfo& info);

    const ParticleView& view() const { return mView; }

    const TileNumbers* tileNumbers() const { return mTile ? &*mTile : nullptr; }

    // Of the file.
    std::size_t chosenGrid() const { return mChosen; }

    // As PointFile::readScalars(), listValues(), readValues() and readGroups(). `file` is the one that was read, opened again.
    std::vector<double> readScalars(const ByteSource& file, const std::string& name,
                                    std::uint64_t allowedBytes, const CancelCheck& cancel) const;
    std::vector<StoredValue> listValues(const ByteSource& file, const CancelCheck& cancel) const;
    // Attributes alone; groups are left to readGroups().
    PointValues readAttributes(const ByteSource& file, const std::vector<StoredValue>& which,
                               std::uint64_t allowedBytes, const CancelCheck& cancel) const;
    std::vector<std::uint8_t> readGroups(const ByteSource& file, const std::string& list,
                                         std::uint64_t allowedBytes, const CancelCheck& cancel) const;

private:
    struct Reopened;

    // Throws InputError where the chosen grid does not have the leaves that were read.
    Reopened reopen(const ByteSource& file, const CancelCheck& cancel) const;

    std::size_t mChosen = 0;
    std::string mGridName; // unique in the file
    ParticleView mView;
    std::optional<TileNumbers> mTile;
};

// As PointFile::writeVdb(), by OpenVDB, which reads the file again: the grid of that number gets the values.
void writeVdbResult(const std::string& from, std::size_t grid, const std::string& path,
                    const PointValues& values, const OutputOptions& options, Progress* progress);

} // namespace vdb_nns

// A .vdb file with a point grid, read and written through OpenVDB. Hides OpenVDB's headers from
// point_file.cpp.
#pragma once

#include "vdb_nns/particle_view.h"
#include "vdb_nns/point_file.h"
#include "vdb_nns/progress.h"

#include <cstdint>
#include <memory>
#include <string>

namespace vdb_nns {

class VdbFile {
public:
    virtual ~VdbFile() = default;

    // As PointFile::read(). Reads the chosen grid only; throws CapacityError where its bytes in the file, or all of a
    // file without offsets, are more than `allowedBytes`.
    static std::unique_ptr<VdbFile> read(const std::string& path, const std::string& grid,
                                         std::uint64_t allowedBytes, Progress* progress);

    // Keeps the grid's memory alive.
    virtual const ParticleView& view() const = 0;

    // Fills in what the format says: all but points, nonfinite, bbox and transform.
    virtual void describe(PointFileInfo& info) const = 0;

    // As PointFile::writeVdb(). Other grids are read from the file again, so it must still be there.
    virtual void write(const std::string& path, Span<const std::uint32_t> counts,
                       const std::string& attribute, const OutputOptions& options,
                       Progress* progress) const = 0;
};

} // namespace vdb_nns

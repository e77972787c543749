// Values of points in a file that a search wrote, by number of the query: points with attributes (.vdb, .ply), or named arrays
// (.npz). What they say is judged elsewhere (measure_check.h); here it is only whose values they are.
#pragma once

#include "vdb_nns/measure.h"
#include "vdb_nns/point_file.h"
#include "vdb_nns/point_values.h"
#include "vdb_nns/progress.h"

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace vdb_nns::cli {

class ResultFile {
public:
    // Whether the file holds values rather than lists: a .vdb, a .ply, or an .npz without any array that lists have.
    static bool holdsValues(const std::string& path);

    // @param grid of a .vdb; empty: the only one
    // @throws as PointFile::read(), InputError for a ZIP that cannot be read
    ResultFile(const std::string& path, const std::string& grid, Progress* progress);

    // A .vdb or .ply without points, which need not say what they would have.
    bool isEmpty() const { return mPoints && mPoints->view().size() == 0; }

    // Whether any of these is there.
    bool hasAny(const MeasuredNames& names) const;

    // What the averages there are of: the rest of each name that begins with `prefix` (its components' names cut off where those
    // of `known` are there so).
    std::vector<std::string> namesBehind(const std::string& prefix,
                                         const std::vector<std::string>& known) const;

    // Those of them that are there. Numbers have the types that the file has, but for those that its format does not have.
    // @throws InputError for a value that is not readable
    PointValues read(const MeasuredNames& names, Progress* progress) const;

    // The number in the file of each query's values; ~0 for those that are not in the file. Empty: all are, in their order.
    // @throws InputError where the file's points are not the queries
    std::vector<std::uint32_t> placesOf(const PointFile& queries, Progress* progress) const;

private:
    std::string mPath;
    std::optional<PointFile> mPoints; // none of an .npz
    std::vector<StoredValue> mList;   // of the points
    std::vector<std::string> mArrays; // of the .npz

    bool isPly() const;
    const StoredValue* find(const std::string& name, bool isGroup) const;
    bool hasAttribute(const std::string& name, AttributeType type) const;
    bool hasGroup(const std::string& name) const;
    void readPly(const MeasuredNames& names, Progress* progress, PointValues& values) const;
};

// By the places of placesOf(); zeros where there are none.
PointValues placedValues(const PointValues& values, const std::vector<std::uint32_t>& places);

} // namespace vdb_nns::cli

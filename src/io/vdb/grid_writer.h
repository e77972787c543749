// Writes a .vdb file of one new point grid. Without OpenVDB's headers.
#pragma once

#include "points/grid_positions.h"
#include "util/cancel.h"
#include "vdb_nns/point_values.h"

#include <cstdint>
#include <optional>
#include <string>

namespace vdb_nns {

class OutputFile;

struct NewGrid {
    const GridPositions& positions;
    std::string name = "points";
    std::string codec = "null";                 // of P
    double voxelSize = 1;                       // world units
    std::optional<double> suggestedRadius = {}; // metadata, world units
    PointValues values = {};                    // in the order of GridPositions::number()
    std::uint64_t valueCount = 0;               // of each array of values
    std::string numberAttribute = {};           // that GridPositions::number() is written as; empty: none
};

// Commits the file. Two equal grids give the same bytes, but for the UUID that OpenVDB draws.
// @throws InvalidInput for an unknown codec and for values as addPointValues() of openvdb_bridge.h; OutputError, Cancelled
void writeNewGrid(OutputFile& file, const NewGrid& content, const CancelCheck& cancel);

} // namespace vdb_nns

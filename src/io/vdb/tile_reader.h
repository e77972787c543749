// Reads a tile of a point grid and what may be within the radius of it, in memory for those points alone. Which leaves those are is
// decided by where their points are, not by where a leaf says that they should be.
#pragma once

#include "io/vdb/point_reader.h"
#include "points/grid_points.h"
#include "util/cancel.h"
#include "vdb_nns/point_file.h"

#include <cstdint>

namespace vdb_nns {

// Fills `points`, whose transform is there already, and says which points those are.
// Cost: reads all points once in pieces, and those of the tile and around it again. Memory: what it returns, 96 bytes a leaf, and
// a piece.
// @param allowedBytes that the points may take
// @throws as VdbPointReader::readPoints(); CapacityError
TileNumbers readTile(const VdbPointReader& reader, const VdbPointLayout& layout, const std::string& path,
                     const TileOfFile& tile, std::uint64_t allowedBytes, const CancelCheck& cancel,
                     GridPoints& points);

} // namespace vdb_nns

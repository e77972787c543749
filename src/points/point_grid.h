// Point grids of OpenVDB: made of positions, and given attributes and groups. For sources that include OpenVDB anyway.
#pragma once

#include "points/grid_positions.h"
#include "util/cancel.h"
#include "util/memory.h"
#include "vdb_nns/point_values.h"

#include <openvdb/points/PointDataGrid.h>

#include <cstdint>
#include <string>

namespace vdb_nns {

// A grid with the attribute P of a codec: null, trnc, fxpt16 or fxpt8. The points of a voxel keep the order of `positions`,
// whatever the number of threads. Name and transform are left to the caller.
// @param numbers receives GridPositions::number() of each point, in the order of the grid's own numbers.
// @throws InvalidInput for another codec; Cancelled
openvdb::points::PointDataGrid::Ptr makePointGrid(const GridPositions& positions, const std::string& codec,
                                                  const CancelCheck& cancel,
                                                  PageArray<std::uint32_t>& numbers);

// As addPointValues() of openvdb_bridge.h, and can be stopped.
// @param numbers of each point of the grid, its number in the arrays of values, whose length is `count`; null: they have
//        the order and the length of the grid.
void addPointValues(openvdb::points::PointDataGrid& grid, const PointValues& values, bool overwrite,
                    const std::uint32_t* numbers, std::uint64_t count, const CancelCheck& cancel);

} // namespace vdb_nns

// The only public header with OpenVDB types: point grids in, result attributes and topology out.
#pragma once

#include "vdb_nns/particle_view.h"
#include "vdb_nns/point_values.h"
#include "vdb_nns/sparse_grid.h"
#include "vdb_nns/types.h"

#include <openvdb/openvdb.h>
#include <openvdb/points/PointDataGrid.h>

#include <string>

namespace vdb_nns {

/// Views the positions of a point grid. Nothing is copied, and nothing is decoded yet. Particles are numbered
/// in the order of `tree().cbeginLeaf()`, and inside a leaf in attribute order.
/// @throws InputError for a non-linear transform, a singular matrix, a P that is missing or is not vec3s with
///         codec null, trnc, fxpt16 or fxpt8, leaf offsets that do not validate, or out-of-core leaves
/// @throws InvalidInput for a null grid or more than 2^32-1 points
ParticleView viewOf(const openvdb::points::PointDataGrid::ConstPtr& grid);

/// Adds attributes and groups to a point grid, with codec null. Others are left as they are.
/// @param values one a point, in the numbering of viewOf().
/// @param overwrite replace attributes and groups that exist; else they are refused.
/// @throws InvalidInput if the numbers of values and points differ, a name is not valid, exists or is given twice, or it is
///         P or an array of groups; the grid is then unchanged
/// @throws InputError if the leaves do not share one set of attributes
void addPointValues(openvdb::points::PointDataGrid& grid, const PointValues& values, bool overwrite = false);

/// Adds or replaces the int32 attribute `name` of a point grid. Other attributes are left as they are.
/// @param values one value a point, in the numbering of viewOf().
/// @throws InvalidInput if the sizes differ, a value is above 2^31-1, the name is not valid, the attribute
///         exists and `overwrite` is false, or it is P or a group
/// @throws InputError if the leaves do not share one set of attributes
void setPointAttribute(openvdb::points::PointDataGrid& grid, const std::string& name,
                       Span<const std::uint32_t> values, bool overwrite = false);

/// The grid's topology: one active voxel for each occupied cell. Valid while the SparseGrid lives.
const openvdb::MaskTree& topologyOf(const SparseGrid& grid);

} // namespace vdb_nns

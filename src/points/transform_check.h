// Whether the map from index to world space gives every point a place of its own.
#pragma once

#include "vdb_nns/types.h"

namespace vdb_nns {

// By pivots relative to the largest one (3 epsilon), so that a tiny scale is no fault but a lost dimension is. False also
// where a number is not finite.
bool isInvertible(const Matrix3& linear, const Vec3d& translation);

} // namespace vdb_nns

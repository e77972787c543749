// Eigenvalues and eigenvectors of a symmetric matrix, by Eigen in long double.
#pragma once

#include "smoothing.h"

#include <array>

namespace vdb_nns::cli {

using Vector3 = std::array<Real, 3>;
using SymmetricMatrix = std::array<Vector3, 3>;

struct EigenSystem {
    Vector3 values;                 // descending
    std::array<Vector3, 3> vectors; // of unit length, in the order of the values; their signs are anyone's
};

EigenSystem eigenSystem(const SymmetricMatrix& matrix);

} // namespace vdb_nns::cli

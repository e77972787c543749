#include "points/transform_check.h"

#include <Eigen/LU>

#include <cmath>

namespace vdb_nns {

bool isInvertible(const Matrix3& linear, const Vec3d& translation)
{
    Eigen::Matrix3d matrix;
    for (int row = 0; row < 3; ++row) {
        for (int column = 0; column < 3; ++column) matrix(row, column) = linear[row][column];
    }
    const bool isFinite =
        matrix.allFinite() && std::isfinite(translation[0] + translation[1] + translation[2]);
    return isFinite && Eigen::FullPivLU<Eigen::Matrix3d>(matrix).isInvertible();
}

} // namespace vdb_nns

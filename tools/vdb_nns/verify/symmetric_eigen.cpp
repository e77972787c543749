#include "symmetric_eigen.h"

#include <Eigen/Eigenvalues>

namespace vdb_nns::cli {

EigenSystem eigenSystem(const SymmetricMatrix& matrix)
{
    using Matrix = Eigen::Matrix<Real, 3, 3>;
    Matrix m;
    for (int row = 0; row < 3; ++row) {
        for (int column = 0; column < 3; ++column)
            m(row, column) = matrix[static_cast<std::size_t>(row)][static_cast<std::size_t>(column)];
    }
    const Eigen::SelfAdjointEigenSolver<Matrix> solver(m);
    EigenSystem system;
    for (int k = 0; k < 3; ++k) { // Eigen's are ascending
        system.values[static_cast<std::size_t>(k)] = solver.eigenvalues()(2 - k);
        for (int axis = 0; axis < 3; ++axis)
            system.vectors[static_cast<std::size_t>(k)][static_cast<std::size_t>(axis)] =
                solver.eigenvectors()(axis, 2 - k);
    }
    return system;
}

} // namespace vdb_nns::cli

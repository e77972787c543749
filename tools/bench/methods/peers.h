// Other libraries as methods of `bench`, one file each.
#pragma once

#include "bench/methods/row_method.h"

#include <cstdint>
#include <memory>
#include <vector>

namespace vdb_nns::cli {

/// World positions as a user of such a library has them: x y z triples, non-finite ones as they are.
template <typename Real>
std::vector<Real> worldPositions(const ParticleView& view);

/// The particles of a set that have its role, for libraries that know no roles.
template <typename Real>
struct Members {
    std::vector<Real> xyz;
    std::vector<std::uint32_t> numbers; ///< empty: all particles of the view

    std::uint32_t number(std::uint32_t k) const { return numbers.empty() ? k : numbers[k]; }
};
template <typename Real>
Members<Real> membersOf(const ParticleSet& set);

std::unique_ptr<Method> makeOpenVdbPeer();

/// Seconds that openvdb::io::File takes to read all grids of a file.
/// @throws openvdb::Exception
double timeOpenVdbRead(const std::string& path);

/// Whether the program was built with nanoflann.
bool hasNanoflann();
/// Null without it.
std::unique_ptr<Method> makeNanoflannPeer(bool inDoubles);

/// Whether the program was built with TreeNSearch.
bool hasTreeNSearch();
/// Null without it. It may end the program, or kill it, where its input does not suit it.
std::unique_ptr<Method> makeTreeNSearchPeer();

/// Every pair, in doubles. Rows ascending.
std::unique_ptr<Method> makeBruteForce();

} // namespace vdb_nns::cli

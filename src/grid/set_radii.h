// Radii of particles: classes of them by halvings of the largest, and what the filter makes of each. Knows lattices; not who is
// searched among whom.
#pragma once

#include "grid/sparse_grid_data.h"
#include "shared/membership.h"
#include "util/memory.h"
#include "vdb_nns/particle_set.h"

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

namespace vdb_nns {

// Whether a particle with this radius reaches anybody.
inline bool reaches(double radius)
{
    return radius > 0 && std::isfinite(radius);
}

// The k with largest / 2^(k+1) < radius <= largest / 2^k. Both reach somebody, and `radius` is no larger than the other.
int halvingsOf(double radius, double largest);

// Radii that are searched on one lattice: after so many halvings of the largest, from `first` to `last`.
struct RadiusClass {
    static constexpr int kAllSmaller = 1 << 30;
    int first, last;

    // A radius that no member passes.
    double upTo(double largest) const { return std::ldexp(largest, -first); }
};

// How radii are spread.
class RadiusCensus {
public:
    // Of all that will be added.
    explicit RadiusCensus(double largest) : mLargest(largest) {}

    // Counts radii of the chosen particles; all, if `chosen` is empty.
    void add(Span<const double> radii, Span<const std::uint8_t> chosen);
    // From the largest down. A class costs a pass over particles, so the smallest ones are one class where they are few.
    std::vector<RadiusClass> classes() const;

private:
    static constexpr std::size_t kMostHalvings = 2100; // from the largest double to the smallest
    using Counts = std::array<std::uint64_t, kMostHalvings>;

    double mLargest;
    Counts mCounts{};
};

// 0 where none reaches anybody.
double largestRadius(Span<const double> radii, Span<const std::uint8_t> chosen);

// 1 for the chosen particles whose radius is in a class, and for those that reach nobody if `alsoUnreaching`.
struct ClassMembers {
    std::vector<std::uint8_t> chosen;
    double largest = 0; // radius among them
    std::size_t count = 0;
};
ClassMembers membersOf(const RadiusClass& c, double largest, Span<const double> radii,
                       Span<const std::uint8_t> chosen, bool alsoUnreaching);

// What the filter needs to know of the largest radius of a search on a lattice.
struct RadiusBounds {
    FilterBounds bounds;
    FilterError error;
    float nearestDoubt; // SearchPart::nearestDoubt

    // `coordinateError`: in cells of all that is sorted on the lattice. `sums`: as filterError() takes them.
    RadiusBounds(const Lattice& lattice, double radius, double coordinateError, int sums);
};

// FilterBounds::far of each slot's radius.
std::shared_ptr<const PageArray<float>> farOfSlots(const SparseGridData& grid, Span<const double> radii,
                                                   const FilterError& error);

} // namespace vdb_nns

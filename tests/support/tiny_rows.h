// Particles whose sums need a scale of their own. Knows only the standard library.
#pragma once

#include <random>
#include <vector>

namespace vdb_nns::testing {

// Sixty places a thousand radii apart, with two to eight points each in balls of the radius down to a billionth of it, or of none, and
// two pairs that are nearly the radius apart. Triples x y z.
inline std::vector<double> rowsOfTinyTerms(double radius)
{
    std::mt19937 random(11);
    std::uniform_real_distribution<double> unit(-1, 1);
    std::vector<double> xyz;
    for (int group = 0; group < 60; ++group) {
        const double spread = std::vector<double>{1, 0, 1e-3, 1e-6, 1e-9, 2e-2}[group % 6];
        for (int k = 0; k < 2 + group % 7; ++k) {
            for (int c = 0; c < 3; ++c)
                xyz.push_back(radius * ((c == 0 ? 1000 * group : 0) + spread * unit(random)));
        }
        for (const double apart : {1 - 1e-12, 1 - 1e-6}) {
            for (const double along : {0.0, apart}) {
                const double at[3] = {1000.0 * group, 5 + 5 * apart, along};
                for (const double x : at) xyz.push_back(radius * x);
            }
        }
    }
    return xyz;
}

} // namespace vdb_nns::testing

// Arrays in, a density for each particle out: the sum of an SPH kernel over the neighbors, by the visitor, so that no
// list is ever stored. Prints the range of densities of a slightly disturbed block of water.
#include <vdb_nns/search.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <vector>

namespace {

const double kPi = 3.14159265358979323846;

// The cubic spline of Monaghan and Lattanzio (1985) with support radius R, in three dimensions: it is 0 at
// distance R, and its integral over space is 1.
double cubicSpline(double distance, double supportRadius)
{
    const double q = 2 * distance / supportRadius;
    const double scale = 8 / (kPi * supportRadius * supportRadius * supportRadius);
    if (q < 1) return scale * (1 - 1.5 * q * q + 0.75 * q * q * q);
    return q < 2 ? scale * 0.25 * (2 - q) * (2 - q) * (2 - q) : 0;
}

struct Particle {
    float position[3];
    float velocity[3]; // the engine strides over what it does not need
};

std::vector<Particle> makeWater(int edge, float spacing)
{
    std::vector<Particle> particles;
    for (int x = 0; x < edge; ++x)
        for (int y = 0; y < edge; ++y)
            for (int z = 0; z < edge; ++z) {
                const float wave = 0.1f * spacing * std::sin(0.7f * static_cast<float>(x + 2 * y + 3 * z));
                particles.push_back({{x * spacing + wave, y * spacing - wave, z * spacing}, {0, 0, 0}});
            }
    return particles;
}

} // namespace

int main()
{
    const float spacing = 0.01f; // meters
    const double radius = 2.5 * spacing;
    const double mass = 1000.0 * spacing * spacing * spacing; // kilograms a particle: water
    const int edge = 40;
    const std::vector<Particle> particles = makeWater(edge, spacing);

    const auto view =
        vdb_nns::ParticleView::fromArray(particles[0].position, particles.size(), sizeof(Particle));
    std::vector<double> density(particles.size());
    // Called from several threads, once for each particle: it writes only its own element.
    vdb_nns::visitNeighbors(
        view, radius,
        [&](std::uint32_t query, vdb_nns::Span<const std::uint32_t>, vdb_nns::Span<const double> distances) {
            double sum = cubicSpline(0, radius); // a particle counts for itself
            for (const double distance : distances) sum += cubicSpline(distance, radius);
            density[query] = mass * sum;
        });

    const auto range = std::minmax_element(density.begin(), density.end());
    const double middle = density[(static_cast<std::size_t>(edge) * edge + edge + 1) * (edge / 2)];
    std::printf("%zu particles; density %.0f (a corner) to %.0f kg/m3; in the middle %.0f\n",
                particles.size(), *range.first, *range.second, middle);
    return std::abs(middle - 1000) < 50 && *range.first < 600 ? 0 : 1;
}

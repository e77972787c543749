// Scenes of connected fluid: dam_break, two_sources, sheet. All are jittered lattices bent into shape; y is up where
// there is an up.
#include "scene_families.h"

#include <algorithm>
#include <cmath>

namespace vdb_nns::scenes {

namespace {

constexpr double kPi = 3.14159265358979323846;

// Particle k of a sheet `width` particles wide whose rows have 1, 2 and 3 layers: rows of one layer first, then two,
// then all others three. Layers of a place are neighbors in the order, places of a row follow.
struct SheetPlace {
    std::uint64_t row, column, layer;
};

SheetPlace sheetPlace(std::uint64_t k, std::uint64_t width, std::uint64_t rowsPerBand)
{
    const std::uint64_t band = width * rowsPerBand; // places of a band
    std::uint64_t layers = 3, firstRow = 2 * rowsPerBand;
    if (k < band) {
        layers = 1;
        firstRow = 0;
    } else if (k < 3 * band) {
        k -= band;
        layers = 2;
        firstRow = rowsPerBand;
    } else {
        k -= 3 * band;
    }
    const std::uint64_t place = k / layers;
    return {firstRow + place / width, place % width, k % layers};
}

// Edge of a sheet of `count` particles with three bands of equal width: 2 n^2 = count.
std::uint64_t sheetWidth(std::uint64_t count)
{
    const double edge = std::sqrt(static_cast<double>(count) / 2);
    return std::max<std::uint64_t>(1, static_cast<std::uint64_t>(edge));
}

// A dam break after the gate: Ritter's solution (1892) for the depth behind the front is a parabola, from the depth of
// the reservoir down to 0. Here lengths are in particles: `length` from the back wall to the front.
struct DamProfile {
    double length;

    std::uint64_t width() const { return static_cast<std::uint64_t>(length / 2) + 1; }
    std::uint64_t slabs() const { return static_cast<std::uint64_t>(length) + 1; }

    // Layers of fluid at slab x; a film of two layers is the least, as on a wet floor.
    std::uint64_t depth(std::uint64_t x) const
    {
        const double reservoir = 0.3 * length;
        const double fall = std::min(1.0, (length - static_cast<double>(x)) / (length - reservoir));
        return std::max<std::uint64_t>(2, static_cast<std::uint64_t>(0.35 * length * fall * fall));
    }

    // First particle of each slab, and the number of all.
    std::vector<std::uint64_t> firsts() const
    {
        std::vector<std::uint64_t> first{0};
        for (std::uint64_t x = 0; x < slabs(); ++x) first.push_back(first.back() + width() * depth(x));
        return first;
    }
};

// The longest dam whose bulk has at most `count` particles.
DamProfile fitDam(std::uint64_t count)
{
    double low = 0, high = 8 * std::cbrt(static_cast<double>(count)) + 8;
    for (int step = 0; step < 40; ++step) {
        const double middle = 0.5 * (low + high);
        (DamProfile{middle}.firsts().back() <= count ? low : high) = middle;
    }
    return {std::floor(low)};
}

void placeBulk(const Job& job, const DamProfile& dam, const std::vector<std::uint64_t>& firsts)
{
    const Random random(job.options.seed, kJitterStream);
    place(job, 0, firsts.back(), {0, 0, 0}, [&](std::uint64_t k, std::uint64_t index) {
        const std::size_t x = pieceOf(firsts, k);
        const std::uint64_t inSlab = k - firsts[x];
        const double y = static_cast<double>(inSlab / dam.width()) + 0.5;
        const double z = static_cast<double>(inSlab % dam.width()) + 0.5;
        return jittered(random, index, {static_cast<double>(x) + 0.5, y, z});
    });
}

// The splash: a sheet thrown up by the wall that the front has hit; it leans back as it rises and thins from three
// layers to one (its rows run downwards).
void placeSplash(const Job& job, std::uint64_t first, std::uint64_t count, const DamProfile& dam)
{
    const std::uint64_t width = std::max<std::uint64_t>(1, dam.width());
    const std::uint64_t rowsPerBand = std::max<std::uint64_t>(1, count / (6 * width));
    const double top = static_cast<double>(count / (2 * width) + 3);
    const Random random(job.options.seed, kJitterStream);
    place(job, first, count, {0, 0, 0}, [&](std::uint64_t k, std::uint64_t index) {
        const SheetPlace at = sheetPlace(k, width, rowsPerBand);
        const double z = static_cast<double>(at.column) + 0.5;
        const double y = std::max(0.0, top - static_cast<double>(at.row)) + 2.5;
        const double rise = y / top, sway = 0.06 * top * rise * wave(z / 40);
        const double x = dam.length + 2 + static_cast<double>(at.layer) - 0.4 * top * rise * rise + sway;
        return jittered(random, index, {x, y, z});
    });
}

// The spray: droplets of 1 to 33 particles on ballistic arcs between the reservoir and the wall.
void placeDroplets(const Job& job, std::uint64_t first, std::uint64_t count, const DamProfile& dam)
{
    const std::vector<Vec3d> balls[4] = {latticeBall(0), latticeBall(1), latticeBall(3), latticeBall(4)};
    const Random kind(job.options.seed, kPieceStream), where(job.options.seed, kPlaceStream);
    std::vector<std::uint64_t> firsts{0};
    while (firsts.back() < count) {
        firsts.push_back(firsts.back() + balls[kind.bits(firsts.size() - 1) % 4].size());
    }
    const Random random(job.options.seed, kJitterStream);
    place(job, first, count, {0, 0, 0}, [&](std::uint64_t k, std::uint64_t index) {
        const std::uint64_t drop = pieceOf(firsts, k);
        const double u = where.uniform(3 * drop), v = where.uniform(3 * drop + 1);
        const double arc = 4 * u * (1 - u); // height of the arc over its foot points
        const double x = dam.length * (0.4 + 0.6 * u);
        const double surface = static_cast<double>(dam.depth(static_cast<std::uint64_t>(x)));
        const double y = surface + 5 + dam.length * 0.5 * arc * v;
        const double z = static_cast<double>(dam.width()) * where.uniform(3 * drop + 2);
        Vec3d p = balls[kind.bits(drop) % 4][k - firsts[drop]];
        return jittered(random, index, {p[0] + x, p[1] + y, p[2] + z});
    });
}

// Lattice places (y, z) with inner <= |(y, z)| < outer: the section of a jet or of a ring, row by row.
std::vector<std::array<float, 2>> ringPlaces(double inner, double outer)
{
    std::vector<std::array<float, 2>> places;
    const int edge = static_cast<int>(outer) + 1;
    for (int y = -edge; y <= edge; ++y) {
        for (int z = -edge; z <= edge; ++z) {
            const double r2 = double(y) * y + double(z) * z;
            if (r2 >= inner * inner && r2 < outer * outer) places.push_back({float(y), float(z)});
        }
    }
    return places;
}

} // namespace

// 94 % bulk, 3 % splash, 3 % spray; the splash takes what the bulk leaves over.
void makeDamBreak(const Job& job)
{
    const DamProfile dam = fitDam(job.count - job.count * 6 / 100);
    const std::vector<std::uint64_t> firsts = dam.firsts();
    if (firsts.back() > job.count) return makeBlock(job); // fewer particles than a dam of length 0 has
    const std::uint64_t bulk = firsts.back();
    const std::uint64_t spray = std::min(job.count * 3 / 100, job.count - bulk);
    placeBulk(job, dam, firsts);
    placeSplash(job, bulk, job.count - bulk - spray, dam);
    placeDroplets(job, job.count - spray, spray, dam);
}

// Two round jets along x from opposite sides, and the disc into which they spread where they meet. A jet of radius R is
// 6 R long, the disc is R/4 thick and reaches to 3 R. Lattice pitch 0.965 h: about 33 neighbors within 2 h.
void makeTwoSources(const Job& job)
{
    constexpr double kPitch = 0.965, kJetLength = 6, kDiscRadius = 3, kDiscThickness = 0.25;
    // Volume of both jets and the disc around them, in R^3.
    const double volume = kPi * (2 * kJetLength + kDiscThickness * (kDiscRadius * kDiscRadius - 1));
    const double radius = std::max(1.0, std::cbrt(static_cast<double>(job.count) / volume));
    const auto section = ringPlaces(0, radius), ring = ringPlaces(radius, kDiscRadius * radius);
    const auto thickness = static_cast<std::uint64_t>(kDiscThickness * radius) + 1;
    const std::uint64_t disc = std::min(job.count, thickness * ring.size());
    const std::uint64_t left = (job.count - disc) / 2, right = job.count - disc - left;
    const Random random(job.options.seed, kJitterStream);
    const auto layers = [&](std::uint64_t first, std::uint64_t count, const auto& places, double x0,
                            double step) {
        place(job, first, count, {0, 0, 0}, [&](std::uint64_t k, std::uint64_t index) {
            const auto& at = places[k % places.size()];
            const double x = x0 + step * static_cast<double>(k / places.size());
            Vec3d p = jittered(random, index, {x, at[0], at[1]});
            for (double& c : p) c *= kPitch;
            return p;
        });
    };
    // The jets run from the meeting plane outwards, so that a part of a layer is at a far end.
    layers(0, left, section, -0.5, -1);
    layers(left, right, section, 0.5, 1);
    layers(left + right, disc, ring, 0.5 - 0.5 * static_cast<double>(thickness), 1);
}

// A sheet with hills 0.12 of its width high; 1, 2 and 3 layers in three bands.
void makeSheet(const Job& job)
{
    const std::uint64_t width = sheetWidth(job.count), rowsPerBand = std::max<std::uint64_t>(1, width / 3);
    const double period = static_cast<double>(width) / 1.5 + 1;
    const Random random(job.options.seed, kJitterStream);
    place(job, 0, job.count, {0, 0, 0}, [&](std::uint64_t k, std::uint64_t index) {
        const SheetPlace at = sheetPlace(k, width, rowsPerBand);
        const double x = static_cast<double>(at.row), z = static_cast<double>(at.column);
        const double hills = 0.08 * period * (wave(x / period) + wave(z / period + 0.3 * wave(x / period)));
        return jittered(random, index, {x, hills + static_cast<double>(at.layer), z});
    });
}

} // namespace vdb_nns::scenes

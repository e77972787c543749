// Scenes that are mostly empty: spray and clusters. Both are lists of pieces; a piece's kind, size and place are drawn
// before the particles, from its number alone. The constants were tuned by counting neighbors at 4 M (spray) and 2 M
// (clusters) particles with r = 2 h.
#include "scene_families.h"

#include <algorithm>
#include <cmath>

namespace vdb_nns::scenes {

namespace {

// ---- spray --------------------------------------------------------------------------------------------------------

// Edge in h of the boxes that hold at most one piece each, so that none overlap.
constexpr double kStratum = 46;
// Least edge in h of the whole box: 1225 radii of 2 h.
constexpr double kSprayBox = 2450;

struct SprayPiece {
    enum Kind { kDroplet, kSheet, kBallistic } kind;
    std::uint64_t size;
    double pitch;          // lattice spacing in h
    int ball;              // droplet: number of its shape
    std::uint64_t edge[2]; // sheet: particles along each side; size / (edge[0] * edge[1]) layers
    Vec3d center;          // in h
};

struct SprayShapes {
    std::vector<std::vector<Vec3d>> balls;

    SprayShapes()
    {
        for (int radius2 = 2; radius2 <= 42; radius2 += 4) balls.push_back(latticeBall(radius2));
    }
};

// Draws piece number p. Of the pieces 32 % are droplets of 19 to 1200 particles, 2 % sheets of one to three layers, and
// the rest ballistic: 12 to 27 lone particles in one stratum. A droplet's pitch of 0.78 to 1.36 h sets its density.
SprayPiece drawSprayPiece(const Random& random, std::uint64_t p, const SprayShapes& shapes)
{
    const auto draw = [&](std::uint64_t k, double low, double high) {
        return random.uniform(8 * p + k, low, high);
    };
    SprayPiece piece{};
    const double kind = draw(0, 0, 1);
    if (kind < 0.32) {
        const double u = draw(1, 0, 1);
        piece.kind = SprayPiece::kDroplet;
        piece.ball = static_cast<int>(u * u * static_cast<double>(shapes.balls.size()));
        piece.size = shapes.balls[static_cast<std::size_t>(piece.ball)].size();
        piece.pitch = draw(2, 0.78, 1.36);
    } else if (kind < 0.34) {
        piece.kind = SprayPiece::kSheet;
        for (std::uint64_t k = 0; k < 2; ++k) piece.edge[k] = static_cast<std::uint64_t>(draw(1 + k, 16, 36));
        piece.size = piece.edge[0] * piece.edge[1] * static_cast<std::uint64_t>(draw(3, 1, 4));
        piece.pitch = draw(4, 0.85, 1.1);
    } else {
        piece.kind = SprayPiece::kBallistic;
        piece.size = static_cast<std::uint64_t>(draw(1, 12, 28));
    }
    return piece;
}

// Strata of the box inside a fountain: a paraboloid that widens with height, z up. In lattice order.
std::vector<std::uint32_t> fountainStrata(std::uint32_t n)
{
    std::vector<std::uint32_t> strata;
    for (std::uint32_t s = 0; s < n * n * n; ++s) {
        const auto unit = [n](std::uint32_t i) { return (i + 0.5) / n; };
        const double x = 2 * unit(s / (n * n)) - 1, y = 2 * unit(s / n % n) - 1, z = unit(s % n);
        if (x * x + y * y <= 0.15 + 0.85 * z) strata.push_back(s);
    }
    return strata;
}

// Gives each piece a stratum of its own: piece p of P draws among the strata p S / P to (p + 1) S / P.
void placePieces(std::vector<SprayPiece>& pieces, const Random& random)
{
    auto n = static_cast<std::uint32_t>(kSprayBox / kStratum) + 1;
    std::vector<std::uint32_t> strata = fountainStrata(n);
    while (strata.size() < pieces.size() + pieces.size() / 2) strata = fountainStrata(++n);
    for (std::uint64_t p = 0; p < pieces.size(); ++p) {
        const std::uint64_t begin = p * strata.size() / pieces.size();
        const std::uint64_t end = (p + 1) * strata.size() / pieces.size();
        const std::uint32_t s = strata[begin + random.bits(4 * p) % (end - begin)];
        const std::uint32_t at[3] = {s / (n * n), s / n % n, s % n};
        // A droplet or sheet is less than 40 h wide: 3 h of play either way keep it inside its stratum.
        for (std::uint64_t k = 0; k < 3; ++k) {
            pieces[p].center[k] = kStratum * (at[k] + 0.5) + random.uniform(4 * p + 1 + k, -3, 3);
        }
    }
}

// Particle k of a piece, without jitter, in h about the piece's centre.
Vec3d sprayPoint(const SprayPiece& piece, std::uint64_t k, std::uint64_t index, const SprayShapes& shapes,
                 const Random& scatter)
{
    if (piece.kind == SprayPiece::kDroplet) return shapes.balls[static_cast<std::size_t>(piece.ball)][k];
    if (piece.kind == SprayPiece::kBallistic) {
        Vec3d p;
        for (std::uint64_t axis = 0; axis < 3; ++axis) p[axis] = scatter.uniform(3 * index + axis, -19, 19);
        return p;
    }
    const std::uint64_t layers = piece.size / (piece.edge[0] * piece.edge[1]), at = k / layers;
    const double x = static_cast<double>(at / piece.edge[1]) - 0.5 * static_cast<double>(piece.edge[0] - 1);
    const double y = static_cast<double>(at % piece.edge[1]) - 0.5 * static_cast<double>(piece.edge[1] - 1);
    return {x, y, 3 * (wave(x / 40) + wave(y / 50)) + static_cast<double>(k % layers)};
}

// ---- clusters -----------------------------------------------------------------------------------------------------

// Quantiles of the normal distribution, by a table of its cumulative density on [-6, 6].
class NormalQuantiles {
public:
    NormalQuantiles() : mCumulative{0}
    {
        for (int i = 0; i < kSteps; ++i) {
            const double x = -6 + (i + 0.5) * kWidth;
            mCumulative.push_back(mCumulative.back() + exponential(-0.5 * x * x));
        }
    }

    // The x below which the share u (0 to 1) of the distribution lies.
    double operator()(double u) const
    {
        const double wanted = u * mCumulative.back();
        const auto after = std::upper_bound(mCumulative.begin() + 1, mCumulative.end() - 1, wanted);
        const double low = *(after - 1), high = *after;
        return -6 + kWidth * (static_cast<double>(after - 1 - mCumulative.begin()) +
                              (wanted - low) / (high - low));
    }

private:
    static constexpr int kSteps = 2400;
    static constexpr double kWidth = 12.0 / kSteps;
    std::vector<double> mCumulative;
};

constexpr double kClusterBox = 24; // edge in h of the space for one cluster, on average

struct Cluster {
    std::uint64_t size;
    double spread; // standard deviation of an axis, in h
};

// Sizes are a log-normal's quantiles, one for each cluster, so that the largest does not depend on luck or seed; their
// order is shuffled. Spreads run over 0.8 to 2.6 h evenly for all sizes: the largest cluster has the least.
std::vector<Cluster> drawClusters(std::uint64_t particles)
{
    constexpr double kMeanLog = 3.12, kSigmaLog = 1.285;
    constexpr double kMeanSize = 51;               // a little under exp(kMeanLog + kSigmaLog^2 / 2)
    constexpr double kGolden = 0.6180339887498949; // multiples modulo 1 fill [0, 1) evenly
    constexpr std::uint64_t kShuffle = 2654435761; // a prime
    const auto number = static_cast<std::uint64_t>(static_cast<double>(particles) / kMeanSize) + 1;
    const NormalQuantiles quantile;
    std::vector<Cluster> clusters;
    std::uint64_t total = 0;
    for (std::uint64_t c = 0; c < number || total < particles; ++c) {
        const std::uint64_t rank = c * kShuffle % number; // 0 is the largest
        const double z = quantile(1 - (static_cast<double>(rank) + 0.5) / static_cast<double>(number));
        const double turn = static_cast<double>(rank) * kGolden;
        const auto size = static_cast<std::uint64_t>(exponential(kMeanLog + kSigmaLog * z)) + 1;
        clusters.push_back({size, 0.8 + 1.8 * (turn - std::floor(turn))});
        total += size;
    }
    return clusters;
}

} // namespace

void makeSpray(const Job& job)
{
    const SprayShapes shapes;
    const Random kind(job.options.seed, kPieceStream);
    std::vector<SprayPiece> pieces;
    std::vector<std::uint64_t> firsts;
    for (std::uint64_t total = 0; total < job.count; total += pieces.back().size) {
        firsts.push_back(total);
        pieces.push_back(drawSprayPiece(kind, pieces.size(), shapes));
    }
    placePieces(pieces, Random(job.options.seed, kPlaceStream));
    const Random jitter(job.options.seed, kJitterStream), scatter(job.options.seed, kScatterStream);
    place(job, 0, job.count, {0, 0, 0}, [&](std::uint64_t k, std::uint64_t index) {
        const std::size_t number = pieceOf(firsts, k);
        const SprayPiece& piece = pieces[number];
        Vec3d p = sprayPoint(piece, k - firsts[number], index, shapes, scatter);
        if (piece.kind != SprayPiece::kBallistic) {
            p = jittered(jitter, index, p);
            for (double& x : p) x *= piece.pitch;
        }
        for (int axis = 0; axis < 3; ++axis) p[axis] += piece.center[axis];
        return p;
    });
}

// Clusters lie anywhere, so some overlap; 5 % of the particles are a background of lone ones.
void makeClusters(const Job& job)
{
    const std::uint64_t lone = job.count / 20, clustered = job.count - lone;
    const std::vector<Cluster> clusters = drawClusters(clustered);
    std::vector<std::uint64_t> firsts;
    std::uint64_t total = 0;
    for (const Cluster& cluster : clusters) {
        firsts.push_back(total);
        total += cluster.size;
    }
    const double box = kClusterBox * std::cbrt(static_cast<double>(clusters.size()));
    const Random where(job.options.seed, kPlaceStream), shape(job.options.seed, kShapeStream);
    place(job, 0, clustered, {0, 0, 0}, [&](std::uint64_t k, std::uint64_t index) {
        const std::size_t c = pieceOf(firsts, k);
        Vec3d p;
        for (std::uint64_t axis = 0; axis < 3; ++axis) {
            p[axis] =
                where.uniform(3 * c + axis, 0, box) + clusters[c].spread * shape.normal(3 * index + axis);
        }
        return p;
    });
    const Random scatter(job.options.seed, kScatterStream);
    place(job, clustered, lone, {0, 0, 0}, [&](std::uint64_t, std::uint64_t index) {
        Vec3d p;
        for (std::uint64_t axis = 0; axis < 3; ++axis) p[axis] = scatter.uniform(3 * index + axis, 0, box);
        return p;
    });
}

} // namespace vdb_nns::scenes

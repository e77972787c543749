// Which particles hang together: connected components of all pairs within the radius ("friends of friends"), and DBSCAN,
// which asks that a point has some neighbors before it connects others.
// The scene is two balls of points with a thin thread between them, and points that lie about: one component because of the
// thread, two clusters for DBSCAN, which calls the rest noise.
#include <vdb_nns/measure.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <map>
#include <vector>

namespace {

const int kBall = 6;    // radius of a ball, spacings
const int kThread = 20; // points between the balls
const int kAlone = 12;

void addBall(std::vector<float>& xyz, int center)
{
    for (int x = -kBall; x <= kBall; ++x)
        for (int y = -kBall; y <= kBall; ++y)
            for (int z = -kBall; z <= kBall; ++z)
                if (x * x + y * y + z * z <= kBall * kBall)
                    xyz.insert(xyz.end(), {static_cast<float>(center + x), static_cast<float>(y),
                                           static_cast<float>(z)});
}

struct Clusters {
    std::map<std::int32_t, std::size_t> points; // by label
    std::size_t noise = 0;
    std::int32_t largest = 0; // as `cluster_size` says
};

Clusters findClusters(const std::vector<float>& xyz, double radius, const vdb_nns::MeasureOptions& options)
{
    const auto view = vdb_nns::ParticleView::fromArray(xyz.data(), xyz.size() / 3);
    const vdb_nns::PointValues values = vdb_nns::measure(view, radius, {"cluster", "cluster_size"}, options);
    const std::int32_t* const label = static_cast<const std::int32_t*>(values.attributes[0].values.get());
    const std::int32_t* const size = static_cast<const std::int32_t*>(values.attributes[1].values.get());

    Clusters found;
    for (std::size_t i = 0; i < view.size(); ++i) {
        if (label[i] < 0)
            ++found.noise;
        else
            ++found.points[label[i]];
        found.largest = std::max(found.largest, size[i]);
    }
    return found;
}

void print(const char* name, const Clusters& found)
{
    std::printf("%-20s %2zu clusters, the largest of %d points; %zu points of noise\n", name,
                found.points.size(), found.largest, found.noise);
}

} // namespace

int main()
{
    std::vector<float> xyz;
    const int between = 2 * kBall + kThread + 1; // of the centers
    addBall(xyz, 0);
    addBall(xyz, between);
    const std::size_t inBalls = xyz.size() / 3;
    for (int i = 1; i <= kThread; ++i) xyz.insert(xyz.end(), {static_cast<float>(kBall + i), 0, 0});
    for (int i = 0; i < kAlone; ++i) xyz.insert(xyz.end(), {static_cast<float>(5 * i), 30, 0});

    const double radius = 1.5; // 18 neighbors in a ball, 2 along the thread
    const Clusters connected = findClusters(xyz, radius, {});
    vdb_nns::MeasureOptions options;
    options.minNeighbors = 5; // the point itself not counted: min_samples = 6 in scikit-learn
    const Clusters dense = findClusters(xyz, radius, options);

    print("friends of friends:", connected);
    print("DBSCAN:", dense);
    // The points of the thread are noise but for the one beside each ball, which is a neighbor of a core point.
    return connected.points.size() == 1 + kAlone && connected.noise == 0 &&
                   connected.points.at(0) == inBalls + kThread && dense.points.size() == 2 &&
                   dense.points.at(0) == dense.points.at(1) && dense.noise + inBalls <= xyz.size() / 3 &&
                   dense.noise >= static_cast<std::size_t>(kThread - 2 + kAlone)
               ? 0
               : 1;
}

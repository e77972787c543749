// One engine over a sequence of frames: it keeps its memory, so that every frame after the first is spared the cost of
// fresh pages. The particles move between the frames; the lists of a frame are read and let go before the next.
#include <vdb_nns/search.h>

#include <cmath>
#include <cstdint>
#include <cstdio>
#include <vector>

namespace {

// Positions of frame t: a block of particles that is sheared over time.
void moveParticles(std::vector<double>& xyz, int edge, double time)
{
    xyz.clear();
    for (int x = 0; x < edge; ++x)
        for (int y = 0; y < edge; ++y)
            for (int z = 0; z < edge; ++z) {
                xyz.push_back(x + 0.3 * time * z + 0.2 * std::sin(1.3 * y));
                xyz.push_back(y + 0.2 * std::sin(1.7 * z));
                xyz.push_back(z);
            }
}

} // namespace

int main()
{
    const int edge = 50, frames = 5;
    const double radius = 2;
    vdb_nns::SearchEngine engine;
    vdb_nns::SearchOptions options;
    options.encoding = vdb_nns::Encoding::kMask; // a bit a candidate: the smallest lists

    std::vector<double> xyz;
    std::uint64_t firstPairs = 0, pairs = 0;
    for (int frame = 0; frame < frames; ++frame) {
        moveParticles(xyz, edge, frame);
        const auto view = vdb_nns::ParticleView::fromArray(xyz.data(), xyz.size() / 3);
        const vdb_nns::NeighborLists lists = engine.findNeighbors(view, radius, options);
        const vdb_nns::ListStatistics& found = lists.statistics();
        const vdb_nns::SearchStatistics& work = engine.statistics();
        std::printf(
            "frame %d: %llu pairs, %u to %u a particle, %.2f bytes a pair, grid %.4f s, search %.4f s\n",
            frame, static_cast<unsigned long long>(found.pairs), found.min, found.max,
            static_cast<double>(lists.bytes()) / static_cast<double>(found.pairs), work.gridSeconds,
            work.searchSeconds);
        pairs = found.pairs;
        if (frame == 0) firstPairs = pairs;
    }
    return firstPairs > 0 && pairs > 0 && pairs != firstPairs ? 0 : 1;
}

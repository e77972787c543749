// Finds the neighbors of particles held in a plain array.
#include <vdb_nns/search.h>

#include <cstdio>
#include <vector>

int main()
{
    const std::vector<float> xyz = {0, 0, 0, 3, 4, 0, 3, 4, 1, 9, 9, 9}; // four particles: x y z, x y z, ...
    const auto view = vdb_nns::ParticleView::fromArray(xyz.data(), xyz.size() / 3);
    const vdb_nns::NeighborLists lists = vdb_nns::findNeighbors(view, 5.0);

    for (std::size_t i = 0; i < lists.size(); ++i) {
        std::printf("particle %zu has %u neighbors:", i, lists.count(i));
        lists.forEachNeighbor(i, [](unsigned neighbor) { std::printf(" %u", neighbor); });
        std::printf("\n");
    }
    return lists.pairCount() == 4 ? 0 : 1; // 0 and 1 are exactly 5 apart: that is within the radius
}

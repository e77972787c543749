// Counts and reads the neighbors of particles held in a plain array.
#include <vdb_nns/search.h>

#include <cstdio>
#include <vector>

int main()
{
    std::vector<float> xyz; // x y z triples: a lattice of 20^3 particles, 0.5 apart
    for (int i = 0; i < 8000; ++i)
        for (int digit : {i % 20, i / 20 % 20, i / 400}) xyz.push_back(0.5f * digit);

    const auto view = vdb_nns::ParticleView::fromArray(xyz.data(), xyz.size() / 3);
    const vdb_nns::NeighborLists lists = vdb_nns::findNeighbors(view, 1.0);

    std::printf("%llu pairs; the first particle has %u neighbors:", (unsigned long long)lists.pairCount(),
                lists.count(0));
    lists.forEachNeighbor(0, [](unsigned neighbor) { std::printf(" %u", neighbor); });
    std::printf("\n");
    return lists.count(0) == 10 ? 0 : 1; // three of them at exactly 1.0: ties count
}

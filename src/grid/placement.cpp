#include "grid/placement.h"

#include "grid/topology.h"
#include "points/particle_source.h"

#include <tbb/parallel_for.h>
#include <tbb/parallel_sort.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <limits>
#include <optional>
#include <string>
#include <utility>

namespace vdb_nns {

namespace {

constexpr std::size_t kBatch = CellMap::kBatch;
constexpr std::size_t kSmallestChunk =
    32768; // below, a chunk's table of leaves costs more than the parallelism gains

std::vector<Chunk> makeChunks(std::size_t count)
{
    const std::size_t threads = static_cast<std::size_t>(tbb::this_task_arena::max_concurrency());
    const std::size_t chunks = std::max<std::size_t>(1, std::min(4 * threads, count / kSmallestChunk));
    std::vector<Chunk> result(chunks);
    for (std::size_t c = 0; c < chunks; ++c) {
        result[c].begin = count * c / chunks;
        result[c].end = count * (c + 1) / chunks;
    }
    return result;
}

// Of a batch with particles out of range: counts the non-finite ones, notes whether there are others. `chosen`: of the batch; null
// for all.
void sortOut(const CellMap& map, const double (*stored)[kBatch], const std::uint8_t* chosen,
             std::size_t count, Chunk& chunk)
{
    for (std::size_t i = 0; i < count; ++i) {
        if (chosen && !chosen[i]) continue;
        const double x = stored[0][i], y = stored[1][i], z = stored[2][i];
        if (map.inRange(x, y, z)) continue;
        if (std::isfinite(x) && std::isfinite(y) && std::isfinite(z)) {
            chunk.outOfRange = true;
        } else {
            ++chunk.nonfinite;
        }
    }
}

std::size_t countChosen(const std::uint8_t* chosen, std::size_t count)
{
    std::size_t sum = 0;
    for (std::size_t i = 0; i < count; ++i) sum += chosen[i] != 0;
    return sum;
}

// `filter`: leaves that it turns down are left out; null: none is.
void locateChunk(const GridMembers& members, const CellMap& map, const TouchFilter* filter, Chunk& chunk,
                 std::uint32_t* leafOf, const CancelCheck& cancel)
{
    const ParticleSource& source = members.view.source();
    double stored[3][kBatch];
    CellMap::Located at;
    for (std::size_t begin = chunk.begin; begin < chunk.end; begin += kBatch) {
        if (begin / kBatch % 64 == 0) cancel.check();
        const std::size_t n = std::min(kBatch, chunk.end - begin);
        const std::uint8_t* const chosen = members.chosen.empty() ? nullptr : members.chosen.data() + begin;
        const std::size_t chosenCount = chosen ? countChosen(chosen, n) : n;
        chunk.members += chosenCount;
        if (chosenCount == 0) {
            std::fill_n(leafOf + begin, n, kNoLeaf);
            continue;
        }
        source.read(begin, n, map.reference, stored[0], stored[1], stored[2]);
        const bool allInRange = map.locate(stored, n, at);
        const bool allChosen = chosenCount == n;
        const auto valid = [&](std::size_t i) {
            return (allChosen || chosen[i]) &&
                   (allInRange || map.inRange(stored[0][i], stored[1][i], stored[2][i]));
        };
        std::uint32_t number = kNoLeaf;
        for (std::size_t i = 0; i < n;) {
            // Neighbors in the input are often neighbors in space: a run in one leaf costs one look-up.
            const std::int32_t x = at.leaf[0][i], y = at.leaf[1][i], z = at.leaf[2][i];
            if (!valid(i) || (filter && !filter->mayTouch(x, y, z))) {
                leafOf[begin + i++] = kNoLeaf;
                continue;
            }
            number = chunk.leaves.numberOf(x, y, z);
            const std::size_t first = i;
            do {
                leafOf[begin + i++] = number;
            } while (i < n && at.leaf[0][i] == x && at.leaf[1][i] == y && at.leaf[2][i] == z && valid(i));
            chunk.leaves.add(number, static_cast<std::uint32_t>(i - first));
        }
        if (!allInRange) sortOut(map, stored, chosen, n, chunk);
    }
}

} // namespace

CapacityError gridDoesNotFit(std::size_t particles, std::size_t leaves, std::uint64_t needed,
                             std::uint64_t allowed)
{
    return CapacityError("the grid of " + std::to_string(particles) + " particles in " +
                             std::to_string(leaves) + " leaves needs at least " + std::to_string(needed) +
                             " bytes while it is made, allowed are " + std::to_string(allowed) +
                             ": allow more host memory, or search a part of the particles at a time",
                         needed, allowed);
}

Placement placeParticles(const GridMembers& members, const CellMap& map, const SearchOptions& options,
                         std::uint32_t* leafOf, const CancelCheck& cancel)
{
    const ParticleSource& source = members.view.source();
    const std::uint64_t most =
        options.hostMemoryBytes ? options.hostMemoryBytes : std::numeric_limits<std::uint64_t>::max();
    Placement placement;
    std::vector<Chunk>& chunks = placement.chunks = makeChunks(source.size());
    std::optional<TouchFilter> filter;
    if (members.around) filter.emplace(members.around->leafOrigins);
    // Of the leaves that all chunks find. Particles in no order have each leaf in every chunk.
    std::atomic<std::uint64_t> bytes{0};
    tbb::parallel_for(std::size_t(0), chunks.size(), [&](std::size_t c) {
        LeafTable& leaves = chunks[c].leaves;
        locateChunk(members, map, filter ? &*filter : nullptr, chunks[c], leafOf, cancel);
        leaves.finish();
        const std::uint64_t sum = bytes += leaves.bytes();
        if (sum > most) throw gridDoesNotFit(source.size(), leaves.size(), sum, most);
    });
    for (const Chunk& chunk : chunks) {
        placement.members += chunk.members;
        placement.nonfinite += chunk.nonfinite;
        placement.outOfRange |= chunk.outOfRange;
    }
    return placement;
}

namespace {

// Which leaves of a chunk touch a leaf of a grid: 1 for those.
std::vector<std::uint8_t> leavesAround(const LeafTable& leaves, const SparseGridData& around)
{
    constexpr std::uint32_t kAtOnce = 64;
    std::vector<std::uint8_t> touches(leaves.size(), 0);
    Vec3i origins[kAtOnce];
    LeafNeighborhood neighborhoods[kAtOnce];
    for (std::uint32_t begin = 0; begin < leaves.size(); begin += kAtOnce) {
        const std::uint32_t count = std::min(kAtOnce, leaves.size() - begin);
        for (std::uint32_t k = 0; k < count; ++k) {
            const Vec3i& at = leaves.leaf(begin + k);
            origins[k] = {at[0] * 8, at[1] * 8, at[2] * 8};
        }
        around.topology.neighborhoods({origins, count}, neighborhoods);
        for (std::uint32_t k = 0; k < count; ++k) {
            const std::uint32_t* const leaf = neighborhoods[k].leaf;
            touches[begin + k] =
                std::any_of(leaf, leaf + kLeavesAround, [](std::uint32_t l) { return l != kNoLeaf; });
        }
    }
    return touches;
}

} // namespace

void mergeLeaves(std::vector<Chunk>& chunks, const SparseGridData* around, SparseGridData& grid)
{
    struct Entry {
        std::uint64_t key;
        std::uint32_t chunk, local;
    };
    // Where none is left out these are empty.
    std::vector<std::vector<std::uint8_t>> isTaken(chunks.size());
    if (around) {
        tbb::parallel_for(std::size_t(0), chunks.size(),
                          [&](std::size_t c) { isTaken[c] = leavesAround(chunks[c].leaves, *around); });
    }
    const auto isLeftOut = [&](std::size_t c, std::uint32_t leaf) { return around && !isTaken[c][leaf]; };
    RootOrder roots;
    std::vector<std::size_t> firstEntry(1, 0);
    for (std::size_t c = 0; c < chunks.size(); ++c) {
        const LeafTable& leaves = chunks[c].leaves;
        std::size_t taken = 0;
        for (std::uint32_t l = 0; l < leaves.size(); ++l) {
            if (isLeftOut(c, l)) continue;
            roots.add(leaves.leaf(l));
            ++taken;
        }
        firstEntry.push_back(firstEntry.back() + taken);
    }
    roots.finish();
    std::vector<Entry> entries(firstEntry.back());
    tbb::parallel_for(std::size_t(0), chunks.size(), [&](std::size_t c) {
        const LeafTable& leaves = chunks[c].leaves;
        Entry* out = entries.data() + firstEntry[c];
        for (std::uint32_t l = 0; l < leaves.size(); ++l) {
            if (!isLeftOut(c, l)) *out++ = {roots.key(leaves.leaf(l)), static_cast<std::uint32_t>(c), l};
        }
        chunks[c].cursor.assign(leaves.size(), kNoLeaf);
    });
    tbb::parallel_sort(entries.begin(), entries.end(), [](const Entry& a, const Entry& b) {
        return a.key != b.key ? a.key < b.key : a.chunk < b.chunk;
    });
    // In parts: what each begins with is known once the leaves and particles of those before it are counted.
    struct Part {
        std::size_t begin, end, leaves;
        std::uint32_t particles;
    };
    const std::size_t partCount = 4 * static_cast<std::size_t>(tbb::this_task_arena::max_concurrency());
    std::vector<Part> parts(partCount);
    const auto isFirst = [&](std::size_t e) { return e == 0 || entries[e].key != entries[e - 1].key; };
    tbb::parallel_for(std::size_t(0), partCount, [&](std::size_t p) {
        Part part{entries.size() * p / partCount, entries.size() * (p + 1) / partCount, 0, 0};
        for (std::size_t e = part.begin; e < part.end; ++e) {
            part.leaves += isFirst(e);
            part.particles += chunks[entries[e].chunk].leaves.count(entries[e].local);
        }
        parts[p] = part;
    });
    std::size_t leafCount = 0;
    std::uint32_t particles = 0;
    for (Part& part : parts) {
        leafCount += std::exchange(part.leaves, leafCount);
        particles += std::exchange(part.particles, particles);
    }
    grid.leafOrigins.resize(leafCount);
    grid.leaves.resize(leafCount + 1);
    tbb::parallel_for(std::size_t(0), partCount, [&](std::size_t p) {
        std::size_t leaf = parts[p].leaves;
        std::uint32_t slot = parts[p].particles;
        for (std::size_t e = parts[p].begin; e < parts[p].end; ++e) {
            Chunk& chunk = chunks[entries[e].chunk];
            const std::uint32_t local = entries[e].local;
            if (isFirst(e)) {
                const Vec3i& at = chunk.leaves.leaf(local);
                grid.leafOrigins[leaf] = {at[0] * 8, at[1] * 8, at[2] * 8};
                grid.leaves[leaf++] = {slot, 0, nullptr};
            }
            chunk.cursor[local] = slot;
            slot += chunk.leaves.count(local);
        }
    });
    grid.leaves[leafCount] = {particles, 0, nullptr};
    for (Chunk& chunk : chunks) chunk.leaves = LeafTable(); // scattering needs the cursors alone
}

} // namespace vdb_nns

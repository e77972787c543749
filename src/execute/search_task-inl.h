// The search of one task, for the instruction set of the including file. Internal linkage throughout, and nothing of the
// standard library that could leave a copy compiled with these flags for other files to use.
//
//   fillHalo:  copies the leaf and its halo into one array by cell, so that the cells of a column stand together
//   for each occupied cell: gather() keeps the candidates near the box of the cell's queries;
//              each query is tested against those, a vector at a time
#include "execute/membership_simd-inl.h"
#include "execute/search_task.h"

namespace vdb_nns {
namespace {

// Pads the kept candidates to a whole vector: far from everything.
constexpr float kFarAway = 1e30f;

inline void copyRun(const BlockView& block, HaloScratch& halo, std::uint32_t at, std::uint32_t begin,
                             std::uint32_t end, const float shift[3])
{
    const Simd::F sx = Simd::set(shift[0]), sy = Simd::set(shift[1]), sz = Simd::set(shift[2]);
    for (std::uint32_t i = begin; i < end; i += Simd::kLanes, at += Simd::kLanes) {
        Simd::store(halo.x + at, Simd::add(Simd::load(block.x + i), sx));
        Simd::store(halo.y + at, Simd::add(Simd::load(block.y + i), sy));
        Simd::store(halo.z + at, Simd::add(Simd::load(block.z + i), sz));
        Simd::store(halo.number + at, Simd::load(block.number + i));
    }
}

// What fillHalo() needs to know of one of the 27 leaves.
struct LeafCells {
    std::uint64_t word[8];
    std::uint32_t firstCell[8]; // number of the first occupied cell of each word
};

std::size_t readLeaves(const BlockView& block, const std::uint32_t* neighborhood, LeafCells* leaves)
{
    std::size_t particles = 0;
    for (int n = 0; n < 27; ++n) {
        LeafCells& leaf = leaves[n];
        if (neighborhood[n] == 0xffffffffu) {
            for (int w = 0; w < 8; ++w) leaf.word[w] = 0;
            continue;
        }
        const LeafRecord& record = block.leaves[neighborhood[n]];
        particles += block.leaves[neighborhood[n] + 1].firstSlot - record.firstSlot;
        std::uint32_t cell = record.firstCell;
        for (int w = 0; w < 8; ++w) {
            leaf.word[w] = record.occupancy[w];
            leaf.firstCell[w] = cell;
            cell += static_cast<std::uint32_t>(__builtin_popcountll(leaf.word[w]));
        }
    }
    return particles;
}

void fillHalo(const BlockView& block, const SearchTask& task, HaloScratch& halo)
{
    const int reach = block.reach, side = 8 + 2 * reach;
    LeafCells leaves[27];
    halo.reserve(halo, readLeaves(block, task.neighborhood, leaves));
    std::uint32_t at = 0, *start = halo.start;
    for (int x = -reach; x < 8 + reach; ++x) {
        const int nx = x < 0 ? 0 : x > 7 ? 2 : 1, w = x & 7;
        for (int ny = 0; ny < 3; ++ny) {
            const int y0 = ny == 0 ? 8 - reach : 0, y1 = ny == 2 ? reach : 8;
            const LeafCells* const column = leaves + nx * 9 + ny * 3;
            if (!(column[0].word[w] | column[1].word[w] | column[2].word[w])) {
                for (int i = (y1 - y0) * side; i > 0; --i) *start++ = at;
                continue;
            }
            for (int y = y0; y < y1; ++y) {
                for (int nz = 0; nz < 3; ++nz) {
                    const int z0 = nz == 0 ? 8 - reach : 0, z1 = nz == 2 ? reach : 8;
                    const std::uint64_t word = column[nz].word[w];
                    const int low = 8 * y + z0;
                    std::uint32_t bits = static_cast<std::uint32_t>(word >> low) & ((1u << (z1 - z0)) - 1);
                    if (!bits) {
                        for (int z = z0; z < z1; ++z) *start++ = at;
                        continue;
                    }
                    const std::uint64_t below = word & ((std::uint64_t(1) << low) - 1);
                    const std::uint32_t* cell =
                        block.cellStart + column[nz].firstCell[w] + __builtin_popcountll(below);
                    const std::uint32_t begin = *cell, offset = at - begin;
                    for (int z = z0; z < z1; ++z, bits >>= 1) {
                        *start++ = *cell + offset; // of the next occupied cell where this one is empty
                        cell += bits & 1;
                    }
                    const float shift[3] = {8.0f * (nx - 1), 8.0f * (ny - 1), 8.0f * (nz - 1)};
                    copyRun(block, halo, at, begin, *cell, shift);
                    at += *cell - begin;
                }
            }
        }
    }
    *start = at;
}

// One cell's queries and the candidates that they keep.
struct CellSearch {
    std::uint32_t firstQuery, queries; // in the halo arrays
    std::uint32_t candidates;          // of the cells in reach
    std::uint32_t kept;
    std::uint32_t self; // kept candidate that is the first query; the others follow
};

// Candidates of the cells in reach of the one whose lowest corner of reach, but for x and y, is `lowest`.
inline std::uint32_t candidatesOf(int reach, const std::uint32_t* lowest)
{
    const int side = 8 + 2 * reach;
    std::uint32_t candidates = 0;
    for (int dx = -reach; dx <= reach; ++dx) {
        for (int dy = -reach; dy <= reach; ++dy) {
            const std::uint32_t* const run = lowest + (dx * side + dy) * side;
            candidates += run[2 * reach + 1] - run[0];
        }
    }
    return candidates;
}

QueryBox boxOf(const FilterBounds& bounds, const HaloScratch& halo, std::uint32_t first, std::uint32_t count)
{
    const float* const in[3] = {halo.x + first, halo.y + first, halo.z + first};
    Simd::F center[3], half[3];
    for (int k = 0; k < 3; ++k) {
        float low = in[k][0], high = in[k][0];
        std::uint32_t i = 0;
        if (count >= Simd::kLanes) {
            Simd::F lows = Simd::load(in[k]), highs = lows;
            for (i = Simd::kLanes; i + Simd::kLanes <= count; i += Simd::kLanes) {
                const Simd::F v = Simd::load(in[k] + i);
                lows = Simd::min(lows, v);
                highs = Simd::max(highs, v);
            }
            low = minOfLanes(lows);
            high = -minOfLanes(Simd::sub(Simd::set(0.0f), highs));
        }
        for (; i < count; ++i) {
            low = in[k][i] < low ? in[k][i] : low;
            high = in[k][i] > high ? in[k][i] : high;
        }
        // The half size must cover each |fl(q - centre)|; rounding is monotonic, so the ends' own roundings do.
        const float c = 0.5f * (low + high), a = high - c, b = c - low;
        center[k] = Simd::set(c);
        half[k] = Simd::set(a > b ? a : b);
    }
    return {center[0], center[1], center[2], half[0], half[1], half[2], Simd::set(bounds.keep)};
}

inline void appendBits(std::uint64_t* words, std::uint32_t at, std::uint64_t bits)
{
    words[at >> 6] |= bits << (at & 63);
    if ((at & 63) + Simd::kLanes > 64) words[(at >> 6) + 1] |= bits >> (64 - (at & 63));
}

// Keeps the candidates of one run of cells that are near the box. Returns how many are kept in all.
template <bool kKeepBits>
inline std::uint32_t gatherRun(const QueryBox& box, HaloScratch& halo, std::uint32_t begin, std::uint32_t end,
                               std::uint32_t kept, std::uint32_t candidate)
{
    for (std::uint32_t i = begin; i < end; i += Simd::kLanes) {
        const Simd::F px = Simd::sub(Simd::load(halo.x + i), box.centerX);
        const Simd::F py = Simd::sub(Simd::load(halo.y + i), box.centerY);
        const Simd::F pz = Simd::sub(Simd::load(halo.z + i), box.centerZ);
        const Simd::Mask mask = box.near(px, py, pz) & firstLanes(end - i);
        if constexpr (kKeepBits) appendBits(halo.keepBits, candidate + (i - begin), mask);
        const Simd::Order order = Simd::order(mask);
        Simd::store(halo.keptX + kept, Simd::compress(px, order));
        Simd::store(halo.keptY + kept, Simd::compress(py, order));
        Simd::store(halo.keptZ + kept, Simd::compress(pz, order));
        Simd::store(halo.keptW + kept, Simd::compress(squaredLength(px, py, pz), order));
        Simd::store(halo.keptNumber + kept, Simd::compress(Simd::load(halo.number + i), order));
        kept += static_cast<std::uint32_t>(__builtin_popcount(mask));
    }
    return kept;
}

// `cell` indexes the halo's cube at the lowest z of the cell's reach.
template <bool kKeepBits>
void gather(const SearchContext& context, HaloScratch& halo, const std::uint32_t* cell, CellSearch& search)
{
    const int reach = context.block.reach, side = 8 + 2 * reach;
    const QueryBox box = boxOf(context.bounds, halo, search.firstQuery, search.queries);
    std::uint32_t kept = 0, candidates = 0;
    if constexpr (kKeepBits) {
        const std::uint32_t all = candidatesOf(reach, cell);
        for (std::uint32_t w = 0; w <= all / 64 + 1; ++w) halo.keepBits[w] = 0;
    }
    for (int dx = -reach; dx <= reach; ++dx) {
        for (int dy = -reach; dy <= reach; ++dy) {
            const std::uint32_t* const run = cell + (dx * side + dy) * side;
            const std::uint32_t begin = run[0], end = run[2 * reach + 1];
            if (dx == 0 && dy == 0) {
                // In two parts, to learn where the first query stands among the kept.
                kept = gatherRun<kKeepBits>(box, halo, begin, search.firstQuery, kept, candidates);
                search.self = kept;
                kept = gatherRun<kKeepBits>(box, halo, search.firstQuery, end, kept,
                                            candidates + (search.firstQuery - begin));
            } else {
                kept = gatherRun<kKeepBits>(box, halo, begin, end, kept, candidates);
            }
            candidates += end - begin;
        }
    }
    for (int i = 0; i < Simd::kLanes; ++i) halo.keptW[kept + i] = kFarAway;
    search.candidates = candidates;
    search.kept = kept;
}

// Tests one query against the kept candidates and hands each vector's hits to emit(first candidate, hits). With kBand
// the judge decides the candidates in the band; without, the result tells whether there are any.
template <bool kBand, typename Emit>
inline bool testQuery(const SearchContext& context, const HaloScratch& halo, const CellSearch& search,
                      std::uint32_t query, const BandJudge& judge, TaskStatistics& statistics, Emit&& emit)
{
    const std::uint32_t self = search.self + query;
    const QueryVectors vectors(context.bounds, halo.keptX[self], halo.keptY[self], halo.keptZ[self]);
    const Simd::I bandTop = Simd::set(context.bounds.bandTop);
    Simd::I least = Simd::set(std::int32_t(0x7fffffff));
    const auto step = [&](std::uint32_t j, Simd::Mask allowed) {
        const Simd::F score =
            vectors.score(halo.keptX + j, halo.keptY + j, halo.keptZ + j, halo.keptW + j);
        Simd::Mask hits = Simd::movesign(score) & allowed;
        if constexpr (kBand) {
            Simd::Mask band = hits & Simd::lessEqual(Simd::bits(score), bandTop);
            for (; band; band &= band - 1) {
                const unsigned lane = static_cast<unsigned>(__builtin_ctz(band));
                ++statistics.bandPairs;
                if (!judge.isNeighbor(judge.state, halo.number[search.firstQuery + query], halo.keptNumber[j + lane])) {
                    hits &= ~(Simd::Mask(1) << lane);
                }
            }
        } else {
            least = Simd::min(least, Simd::bits(score));
        }
        emit(j, hits);
    };
    const std::uint32_t selfVector = self - self % Simd::kLanes;
    std::uint32_t j = 0;
    for (; j < selfVector; j += Simd::kLanes) step(j, kAllLanes);
    step(j, kAllLanes & ~(Simd::Mask(1) << self % Simd::kLanes));
    for (j += Simd::kLanes; j < search.kept; j += Simd::kLanes) step(j, kAllLanes);
    return !kBand && Simd::lessEqual(least, bandTop) != 0;
}

// Calls f(lowest, cell, first slot) for each cell with queries of the task; `lowest` points into the halo's cube at the
// cell of the same column that is `reach` below.
template <typename F>
inline void forEachCell(const BlockView& block, const SearchTask& task, const HaloScratch& halo, F&& f)
{
    const int reach = block.reach, side = 8 + 2 * reach;
    const LeafRecord& leaf = block.leaves[task.leaf];
    const std::uint32_t* cellStart = block.cellStart + leaf.firstCell;
    for (int x = 0; x < 8; ++x) {
        for (std::uint64_t word = leaf.occupancy[x]; word; word &= word - 1, ++cellStart) {
            const std::uint32_t begin = cellStart[0] > task.firstSlot ? cellStart[0] : task.firstSlot;
            const std::uint32_t end = cellStart[1] < task.endSlot ? cellStart[1] : task.endSlot;
            if (begin >= end) continue;
            const int bit = __builtin_ctzll(word), y = bit >> 3, z = bit & 7;
            const std::uint32_t* const lowest = halo.start + ((x + reach) * side + y + reach) * side + z;
            CellSearch cell{};
            cell.firstQuery = lowest[reach] + (begin - cellStart[0]);
            cell.queries = end - begin;
            f(lowest, cell, begin);
        }
    }
}

struct IndexRows {
    static constexpr bool kKeepBits = false;

    static void prepare(const SearchContext&, const SearchTask&, const HaloScratch&, RowSink&) {}

    static void search(const SearchContext& context, HaloScratch& halo, const CellSearch& search, std::uint32_t slot,
                       const BandJudge& judge, RowSink& sink, TaskStatistics& statistics)
    {
        for (std::uint32_t q = 0; q < search.queries; ++q) {
            const std::size_t most = search.kept + Simd::kLanes;
            if (static_cast<std::size_t>(sink.end - sink.out) < most) sink.grow(sink, most);
            const std::uint32_t row = slot + q - sink.slotBase;
            std::uint32_t* out = sink.out;
            const auto emit = [&](std::uint32_t j, Simd::Mask hits) {
                Simd::store(out, Simd::compress(Simd::load(halo.keptNumber + j), Simd::order(hits)));
                out += __builtin_popcount(hits);
            };
            if (testQuery<false>(context, halo, search, q, judge, statistics, emit)) {
                out = sink.out;
                testQuery<true>(context, halo, search, q, judge, statistics, emit);
            }
            const auto count = static_cast<std::uint32_t>(out - sink.out);
            sink.rowBegin[row] = sink.out;
            sink.rowCount[row] = count;
            statistics.pairs += count;
            sink.out = out;
            sink.nextSlot = slot + q + 1;
        }
    }
};

struct CountRows {
    static constexpr bool kKeepBits = false;

    static void prepare(const SearchContext&, const SearchTask&, const HaloScratch&, RowSink&) {}

    static void search(const SearchContext& context, HaloScratch& halo, const CellSearch& search, std::uint32_t slot,
                       const BandJudge& judge, RowSink& sink, TaskStatistics& statistics)
    {
        for (std::uint32_t q = 0; q < search.queries; ++q) {
            std::uint32_t count = 0;
            const auto emit = [&](std::uint32_t, Simd::Mask hits) {
                count += static_cast<std::uint32_t>(__builtin_popcount(hits));
            };
            if (testQuery<false>(context, halo, search, q, judge, statistics, emit)) {
                count = 0;
                testQuery<true>(context, halo, search, q, judge, statistics, emit);
            }
            sink.rowCount[slot + q - sink.slotBase] = count;
            statistics.pairs += count;
        }
    }
};

// The lowest bits of `bits`, one for each set bit of `keep`, moved to the places of those.
inline std::uint64_t deposit(std::uint64_t bits, std::uint64_t keep)
{
#if defined(__BMI2__)
    return _pdep_u64(bits, keep);
#else
    std::uint64_t out = 0;
    for (; keep; keep &= keep - 1, bits >>= 1) out |= (bits & 1) * (keep & -keep);
    return out;
#endif
}

// One bit for each candidate of the cells in reach, in visiting order, padded to 32-bit words.
struct MaskRows {
    static constexpr bool kKeepBits = true;

    static void prepare(const SearchContext& context, const SearchTask& task, const HaloScratch& halo, RowSink& sink)
    {
        std::size_t words = 0;
        forEachCell(context.block, task, halo, [&](const std::uint32_t* lowest, const CellSearch& cell, std::uint32_t) {
            words += std::size_t(cell.queries) * ((candidatesOf(context.block.reach, lowest) + 31) / 32);
        });
        sink.grow(sink, words + 2); // a row is written 64 bits at a time
        sink.taskBegin = sink.out;
    }

    static void search(const SearchContext& context, HaloScratch& halo, const CellSearch& search, std::uint32_t slot,
                       const BandJudge& judge, RowSink& sink, TaskStatistics& statistics)
    {
        const std::uint32_t rowWords = (search.candidates + 31) / 32;
        for (std::uint32_t q = 0; q < search.queries; ++q) {
            std::uint64_t hitWord = 0;
            const auto emit = [&](std::uint32_t j, Simd::Mask hits) {
                hitWord |= std::uint64_t(hits) << (j & 63);
                if ((j & 63) == 64 - Simd::kLanes) {
                    halo.hitBits[j >> 6] = hitWord;
                    hitWord = 0;
                }
            };
            if (testQuery<false>(context, halo, search, q, judge, statistics, emit)) {
                hitWord = 0;
                testQuery<true>(context, halo, search, q, judge, statistics, emit);
            }
            if ((search.kept + Simd::kLanes - 1) / Simd::kLanes * Simd::kLanes % 64) halo.hitBits[search.kept >> 6] = hitWord;
            const std::uint32_t count = writeRow(halo, rowWords, sink.out);
            sink.rowCount[slot + q - sink.slotBase] = count;
            sink.out += rowWords;
            statistics.pairs += count;
        }
    }

private:
    static std::uint32_t writeRow(const HaloScratch& halo, std::uint32_t rowWords, std::uint32_t* row)
    {
        std::uint32_t hit = 0, count = 0;
        for (std::uint32_t w = 0; w < rowWords; w += 2) {
            const std::uint64_t keep = halo.keepBits[w / 2];
            std::uint64_t bits = halo.hitBits[hit >> 6] >> (hit & 63);
            if (hit & 63) bits |= halo.hitBits[(hit >> 6) + 1] << (64 - (hit & 63));
            hit += static_cast<std::uint32_t>(__builtin_popcountll(keep));
            const std::uint64_t out = deposit(bits, keep);
            count += static_cast<std::uint32_t>(__builtin_popcountll(out));
            std::memcpy(row + w, &out, sizeof out);
        }
        return count;
    }
};

template <typename Rows>
void searchTask(const SearchContext& context, const SearchTask& task, const BandJudge& judge, HaloScratch& halo,
                RowSink& sink, TaskStatistics& statistics)
{
    const BlockView& block = context.block;
    fillHalo(block, task, halo);
    Rows::prepare(context, task, halo, sink);
    forEachCell(block, task, halo, [&](const std::uint32_t* lowest, CellSearch& cell, std::uint32_t firstSlot) {
        gather<Rows::kKeepBits>(context, halo, lowest, cell);
        statistics.candidateTests += std::uint64_t(cell.queries) * cell.candidates;
        Rows::search(context, halo, cell, firstSlot, judge, sink, statistics);
    });
}

} // namespace
} // namespace vdb_nns

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

inline void copyRun(const BlockView& block, char* to, std::size_t stride, std::uint32_t begin,
                    std::uint32_t end, const float shift[3])
{
    const Simd::F sx = Simd::set(shift[0]), sy = Simd::set(shift[1]), sz = Simd::set(shift[2]);
    for (std::uint32_t i = begin; i < end; i += Simd::kLanes, to += Simd::kLanes * sizeof(float)) {
        Simd::store(floats(to), Simd::add(Simd::load(block.x + i), sx));
        Simd::store(floats(to + stride), Simd::add(Simd::load(block.y + i), sy));
        Simd::store(floats(to + 2 * stride), Simd::add(Simd::load(block.z + i), sz));
        Simd::store(integers(to + 4 * stride), Simd::load(block.number + i));
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
                    copyRun(block, halo.halo() + std::size_t(at) * sizeof(float), halo.stride, begin, *cell,
                            shift);
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
    Simd::F center[3], half[3];
    for (int k = 0; k < 3; ++k) {
        const float* const in = floats(halo.halo() + k * halo.stride) + first;
        Simd::F low, high;
        if (count >= Simd::kLanes) {
            low = high = Simd::load(in + count - Simd::kLanes);
            for (std::uint32_t i = 0; i + Simd::kLanes < count; i += Simd::kLanes) {
                const Simd::F v = Simd::load(in + i);
                low = Simd::min(low, v);
                high = Simd::max(high, v);
            }
        } else {
            low = high = firstLanesOr(Simd::load(in), count, Simd::set(*in));
        }
        // The half size must cover each |fl(q - centre)|; rounding is monotonic, so the ends' own roundings do.
        const float l = minOfLanes(low), h = maxOfLanes(high), c = 0.5f * (l + h), a = h - c, b = c - l;
        center[k] = Simd::set(c);
        half[k] = Simd::set(a > b ? a : b);
    }
    return {center[0], center[1], center[2], half[0], half[1], half[2], Simd::set(bounds.keep)};
}

// Bits one after the other into 64-bit words. Fewer than 64 at a time.
struct BitWriter {
    std::uint64_t* out;
    std::uint64_t word = 0;
    unsigned filled = 0;

    void append(std::uint64_t bits, unsigned count)
    {
        word |= bits << filled;
        filled += count;
        if (filled >= 64) {
            *out++ = word;
            filled -= 64;
            word = filled ? bits >> (count - filled) : 0;
        }
    }

    void finish() { *out = word; }
};

// One vector of candidates at `p`, of which `valid` count: keeps those near the box, behind `kept`.
template <bool kBits>
inline char* gatherVector(const QueryBox& box, const char* p, std::size_t stride, Simd::Mask valid,
                          unsigned count, char* kept, BitWriter& bits)
{
    const Simd::F px = Simd::sub(Simd::load(floats(p)), box.centerX);
    const Simd::F py = Simd::sub(Simd::load(floats(p + stride)), box.centerY);
    const Simd::F pz = Simd::sub(Simd::load(floats(p + 2 * stride)), box.centerZ);
    const Simd::Mask mask = box.near(px, py, pz) & valid;
    if constexpr (kBits) bits.append(mask, count);
    const Simd::Order order = Simd::order(mask);
    Simd::store(floats(kept), Simd::compress(px, order));
    Simd::store(floats(kept + stride), Simd::compress(py, order));
    Simd::store(floats(kept + 2 * stride), Simd::compress(pz, order));
    Simd::store(floats(kept + 4 * stride), Simd::compress(squaredLength(px, py, pz), order));
    Simd::store(integers(kept + 8 * stride), Simd::compress(Simd::load(integers(p + 4 * stride)), order));
    return kept + static_cast<std::size_t>(__builtin_popcount(mask)) * sizeof(float);
}

// The candidates of one run of cells. Returns where the next kept one goes.
template <bool kBits>
inline char* gatherRun(const QueryBox& box, const char* halo, std::size_t stride, std::uint32_t begin,
                       std::uint32_t end, char* kept, BitWriter& bits)
{
    const char* p = halo + std::size_t(begin) * sizeof(float);
    std::uint32_t left = end - begin;
    for (; left >= Simd::kLanes; left -= Simd::kLanes, p += Simd::kLanes * sizeof(float)) {
        kept = gatherVector<kBits>(box, p, stride, kAllLanes, Simd::kLanes, kept, bits);
    }
    if (left > 0) kept = gatherVector<kBits>(box, p, stride, (1u << left) - 1, left, kept, bits);
    return kept;
}

// `lowest` indexes the halo's cube at the lowest z of the cell's reach.
template <bool kBits>
void gather(const SearchContext& context, HaloScratch& scratch, const std::uint32_t* lowest, CellSearch& cell)
{
    const int reach = context.block.reach, side = 8 + 2 * reach;
    const QueryBox box = boxOf(context.bounds, scratch, cell.firstQuery, cell.queries);
    const char* const halo = scratch.halo();
    const std::size_t stride = scratch.stride;
    char* kept = scratch.kept();
    BitWriter bits{scratch.keepBits()};
    std::uint32_t candidates = 0;
    for (int dx = -reach; dx <= reach; ++dx) {
        for (int dy = -reach; dy <= reach; ++dy) {
            const std::uint32_t* const run = lowest + (dx * side + dy) * side;
            std::uint32_t begin = run[0];
            const std::uint32_t end = run[2 * reach + 1];
            candidates += end - begin;
            if (dx == 0 && dy == 0) {
                // In two parts, to learn where the first query stands among the kept.
                kept = gatherRun<kBits>(box, halo, stride, begin, cell.firstQuery, kept, bits);
                cell.self = static_cast<std::uint32_t>((kept - scratch.kept()) / sizeof(float));
                begin = cell.firstQuery;
            }
            kept = gatherRun<kBits>(box, halo, stride, begin, end, kept, bits);
        }
    }
    if constexpr (kBits) bits.finish();
    Simd::store(floats(kept + 4 * stride), Simd::set(kFarAway));
    cell.candidates = candidates;
    cell.kept = static_cast<std::uint32_t>((kept - scratch.kept()) / sizeof(float));
}

// Tests one query against the kept candidates and hands each vector's hits to emit(where the vector is, hits). With
// kBand the judge decides the candidates in the band; without, the result tells whether there are any.
template <bool kBand, typename Emit>
inline bool testQuery(const SearchContext& context, const HaloScratch& scratch, const CellSearch& cell,
                      std::uint32_t query, const BandJudge& judge, TaskStatistics& statistics, Emit&& emit)
{
    constexpr std::size_t kVector = Simd::kLanes * sizeof(float);
    const char* p = scratch.kept();
    const std::size_t stride = scratch.stride;
    const std::uint32_t self = cell.self + query;
    const char* const own = p + std::size_t(self) * sizeof(float);
    const QueryVectors vectors(context.bounds, *floats(own), *floats(own + stride), *floats(own + 2 * stride),
                               *floats(own + 4 * stride));
    const Simd::I bandTop = Simd::set(context.bounds.bandTop);
    Simd::I least = Simd::set(std::int32_t(0x7fffffff));
    const auto step = [&](Simd::Mask without) {
        const Simd::F score = vectors.score(p, stride);
        Simd::Mask hits = Simd::movesign(score) & ~without;
        if constexpr (kBand) {
            Simd::Mask band = hits & Simd::lessEqual(Simd::bits(score), bandTop);
            for (; band; band &= band - 1) {
                const unsigned lane = static_cast<unsigned>(__builtin_ctz(band));
                ++statistics.bandPairs;
                const std::uint32_t i = integers(own + 8 * stride)[0], j = integers(p + 8 * stride)[lane];
                if (!judge.isNeighbor(judge.state, i, j)) hits &= ~(Simd::Mask(1) << lane);
            }
        } else {
            least = Simd::min(least, Simd::bits(score));
        }
        emit(p, hits);
        p += kVector;
    };
    const char* const selfVector = p + std::size_t(self / Simd::kLanes) * kVector;
    const char* const end = p + std::size_t(cell.kept) * sizeof(float);
    while (p < selfVector) step(0);
    step(Simd::Mask(1) << self % Simd::kLanes);
    while (p < end) step(0);
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

// Rows of numbers, straight to the sink's memory.
struct DirectRows {
    static constexpr bool kKeepBits = false;

    DirectRows(const SearchContext&, const SearchTask&, const HaloScratch&, RowSink& rowSink) : sink(rowSink)
    {
    }

    std::uint32_t* reserve(std::size_t entries)
    {
        if (static_cast<std::size_t>(sink.end - sink.out) < entries) sink.grow(sink, entries);
        return sink.out;
    }

    // A row of `count` entries stands where reserve() said. Returns where it will be read.
    std::uint32_t* commit(std::uint32_t count)
    {
        sink.out += count;
        return sink.out - count;
    }

    void finish() {}

    RowSink& sink;
};

// Rows of numbers that go to the sink's memory past the caches. Lists are written once and not read soon, and ordinary
// stores would read every line from memory before overwriting it. Rows are made in a staging buffer in the cache; whole
// lines leave from there, and the part of a line that a task leaves waits in the sink for the next one.
struct StreamedRows {
    static constexpr bool kKeepBits = false;
    static constexpr std::size_t kLine = 16; // entries
    static constexpr std::size_t kFlushAt =
        1024; // entries: 4 KB, and HaloScratch has room for as many past the kept

    StreamedRows(const SearchContext&, const SearchTask&, const HaloScratch& scratch, RowSink& rowSink)
        : sink(rowSink), staging(scratch.staging()), staged(rowSink.tailSize)
    {
        for (std::size_t k = 0; k < staged; ++k) staging[k] = sink.tail[k];
    }

    std::uint32_t* reserve(std::size_t entries)
    {
        if (static_cast<std::size_t>(sink.end - sink.out) < staged + entries) {
            finish();
            sink.grow(sink, entries + kLine);
            staged = 0;
        }
        return staging + staged;
    }

    std::uint32_t* commit(std::uint32_t count)
    {
        std::uint32_t* const row = sink.out + staged;
        staged += count;
        if (staged >= kFlushAt) flush();
        return row;
    }

    void flush()
    {
        std::size_t i = 0;
        for (; i + kLine <= staged; i += kLine) {
            for (std::size_t k = 0; k < kLine; k += Simd::kLanes) {
                Simd::stream(sink.out + i + k, Simd::load(staging + i + k));
            }
        }
        sink.out += i;
        staged -= i;
        for (std::size_t k = 0; k < staged; ++k) staging[k] = staging[i + k];
    }

    void finish()
    {
        flush();
        for (std::size_t k = 0; k < staged; ++k) sink.tail[k] = staging[k];
        sink.tailSize = static_cast<std::uint32_t>(staged);
        Simd::streamFence();
    }

    RowSink& sink;
    std::uint32_t* staging;
    std::size_t staged;
};

template <typename Target>
struct IndexRows : Target {
    using Target::Target;

    void search(const SearchContext& context, const HaloScratch& scratch, const CellSearch& cell,
                std::uint32_t slot, const BandJudge& judge, TaskStatistics& statistics)
    {
        RowSink& sink = this->sink;
        const std::size_t stride = scratch.stride, most = cell.kept + Simd::kLanes;
        std::uint64_t pairs = 0;
        for (std::uint32_t q = 0; q < cell.queries; ++q) {
            std::uint32_t* const begin = this->reserve(most);
            std::uint32_t* out = begin;
            const auto emit = [&](const char* p, Simd::Mask hits) {
                Simd::store(out, Simd::compress(Simd::load(integers(p + 8 * stride)), Simd::order(hits)));
                out += __builtin_popcount(hits);
            };
            if (testQuery<false>(context, scratch, cell, q, judge, statistics, emit)) {
                out = begin;
                testQuery<true>(context, scratch, cell, q, judge, statistics, emit);
            }
            const auto count = static_cast<std::uint32_t>(out - begin);
            const std::uint32_t row = slot + q - sink.slotBase;
            sink.rowBegin[row] = this->commit(count);
            sink.rowCount[row] = count;
            sink.nextSlot = slot + q + 1;
            pairs += count;
        }
        statistics.pairs += pairs;
    }
};

struct CountRows {
    static constexpr bool kKeepBits = false;

    CountRows(const SearchContext&, const SearchTask&, const HaloScratch&, RowSink& rowSink) : sink(rowSink)
    {
    }

    void search(const SearchContext& context, const HaloScratch& scratch, const CellSearch& cell,
                std::uint32_t slot, const BandJudge& judge, TaskStatistics& statistics)
    {
        for (std::uint32_t q = 0; q < cell.queries; ++q) {
            std::uint32_t count = 0;
            const auto emit = [&](const char*, Simd::Mask hits) {
                count += static_cast<std::uint32_t>(__builtin_popcount(hits));
            };
            if (testQuery<false>(context, scratch, cell, q, judge, statistics, emit)) {
                count = 0;
                testQuery<true>(context, scratch, cell, q, judge, statistics, emit);
            }
            sink.rowCount[slot + q - sink.slotBase] = count;
            statistics.pairs += count;
        }
    }

    void finish() {}

    RowSink& sink;
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

    MaskRows(const SearchContext& context, const SearchTask& task, const HaloScratch& scratch,
             RowSink& rowSink)
        : sink(rowSink)
    {
        std::size_t words = 0;
        forEachCell(context.block, task, scratch,
                    [&](const std::uint32_t* lowest, const CellSearch& cell, std::uint32_t) {
                        words += std::size_t(cell.queries) *
                                 ((candidatesOf(context.block.reach, lowest) + 31) / 32);
                    });
        sink.grow(sink, words + 2); // a row is written 64 bits at a time
        sink.taskBegin = sink.out;
    }

    void search(const SearchContext& context, const HaloScratch& scratch, const CellSearch& cell,
                std::uint32_t slot, const BandJudge& judge, TaskStatistics& statistics)
    {
        const std::uint32_t rowWords = (cell.candidates + 31) / 32;
        std::uint64_t* const hitBits = scratch.hitBits();
        for (std::uint32_t q = 0; q < cell.queries; ++q) {
            BitWriter bits{hitBits};
            const auto emit = [&](const char*, Simd::Mask hits) { bits.append(hits, Simd::kLanes); };
            if (testQuery<false>(context, scratch, cell, q, judge, statistics, emit)) {
                bits = BitWriter{hitBits};
                testQuery<true>(context, scratch, cell, q, judge, statistics, emit);
            }
            bits.finish();
            const std::uint32_t count = writeRow(hitBits, scratch.keepBits(), rowWords, sink.out);
            sink.rowCount[slot + q - sink.slotBase] = count;
            sink.out += rowWords;
            statistics.pairs += count;
        }
    }

    void finish() {}

    RowSink& sink;

private:
    static std::uint32_t writeRow(const std::uint64_t* hitBits, const std::uint64_t* keepBits,
                                  std::uint32_t rowWords, std::uint32_t* row)
    {
        std::uint32_t hit = 0, count = 0;
        for (std::uint32_t w = 0; w < rowWords; w += 2) {
            const std::uint64_t keep = keepBits[w / 2];
            // Two shifts, as one by 64 would be none.
            const std::uint64_t bits = hitBits[hit >> 6] >> (hit & 63) | hitBits[(hit >> 6) + 1]
                                                                             << 1 << (63 - (hit & 63));
            hit += static_cast<std::uint32_t>(__builtin_popcountll(keep));
            const std::uint64_t out = deposit(bits, keep);
            count += static_cast<std::uint32_t>(__builtin_popcountll(out));
            std::memcpy(row + w, &out, sizeof out);
        }
        return count;
    }
};

template <typename Rows>
void searchTask(const SearchContext& context, const SearchTask& task, const BandJudge& judge,
                HaloScratch& halo, RowSink& sink, TaskStatistics& statistics)
{
    const BlockView& block = context.block;
    fillHalo(block, task, halo);
    Rows rows(context, task, halo, sink);
    forEachCell(block, task, halo,
                [&](const std::uint32_t* lowest, CellSearch& cell, std::uint32_t firstSlot) {
                    gather<Rows::kKeepBits>(context, halo, lowest, cell);
                    statistics.candidateTests += std::uint64_t(cell.queries) * cell.candidates;
                    rows.search(context, halo, cell, firstSlot, judge, statistics);
                });
    rows.finish();
}

} // namespace
} // namespace vdb_nns

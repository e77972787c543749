// A consumer of rows (search_rows-inl.h): one bit for each candidate of the cells in reach, in visiting order, padded to 32-bit
// words. Tests see the candidates that the ball filter kept; a row's bits move to the places of those among all at its
// end. Internal linkage.
#pragma once

#include "cpu/search_rows-inl.h"

namespace vdb_nns {
namespace {

constexpr std::uint32_t kRowWordBits = 32;

// Of a row of so many candidates.
inline std::uint32_t rowWordsOf(std::uint32_t candidates)
{
    return (candidates + kRowWordBits - 1) / kRowWordBits;
}

// Of all rows of a task whose halo has been filled. `queries`: the block that they are of.
inline std::size_t rowWordsOf(const BlockView& queries, const SearchTask& task, const HaloScratch& scratch)
{
    std::size_t words = 0;
    forEachCell(queries, task, scratch,
                [&](const std::uint32_t* lowest, const CellSearch& cell, std::uint32_t) {
                    words += std::size_t(cell.queries) * rowWordsOf(candidatesOf(queries.reach, lowest));
                });
    return words;
}

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

// The hits of one query by kept candidate, as bits. Vectors of 8 lanes and more write whole bytes.
struct HitWriter {
    std::uint64_t* words;
    BitWriter bits{words};
    char* bytes = reinterpret_cast<char*>(words);

    explicit HitWriter(std::uint64_t* out) : words(out) {}

    void take(Simd::I, Simd::I, Simd::Mask hits)
    {
        if constexpr (Simd::kLanes >= 8) {
            std::memcpy(bytes, &hits, Simd::kLanes / 8);
            bytes += Simd::kLanes / 8;
        } else {
            bits.append(hits, Simd::kLanes);
        }
    }

    void finish()
    {
        if constexpr (Simd::kLanes < 8) bits.finish();
    }
};

struct MaskRows {
    static constexpr bool kByCandidate = true;

    using Row = HitWriter;

    struct Group {
        MaskRows& rows;
        const std::uint64_t* keepBits;
        std::uint64_t* hitBits;
        std::uint64_t* secondHitBits;
        std::uint32_t rowWords;
        std::uint32_t* counts;
        std::uint32_t* out;

        Group(MaskRows& maskRows, const Queries& queries, std::uint32_t)
            : rows(maskRows),
              keepBits(maskRows.scratch.keepBits()),
              hitBits(maskRows.scratch.hitBits()),
              secondHitBits(maskRows.scratch.secondHitBits()),
              rowWords(rowWordsOf(queries.candidates)),
              counts(maskRows.sink.rowCount + (queries.slot - maskRows.sink.slotBase)),
              out(maskRows.sink.out)
        {
        }

        void begin(int) {}
        Row first() const { return Row(hitBits); }
        Row second() const { return Row(secondHitBits); }

        std::uint32_t end(Row row)
        {
            row.finish();
            const std::uint32_t count = writeRow(row.words);
            *counts++ = count;
            out += rowWords;
            return count;
        }

        std::uint32_t endPair(Row a, Row b)
        {
            const std::uint32_t count = end(a);
            return count + end(b);
        }

        void finish() { rows.sink.out = out; }

    private:
        // Moves the hits of kept candidates to the places of these among all candidates; writes 64 bits at a time.
        std::uint32_t writeRow(const std::uint64_t* hitWords) const
        {
            constexpr std::uint32_t kSureBits =
                57; // that a read of 64 from a whole byte has past the bit wanted
            std::uint32_t hit = 0, count = 0;
            for (std::uint32_t w = 0; w < rowWords; w += 2) {
                const std::uint64_t keep = keepBits[w / 2];
                const auto kept = static_cast<std::uint32_t>(__builtin_popcountll(keep));
                std::uint64_t bits;
                std::memcpy(&bits, reinterpret_cast<const char*>(hitWords) + hit / 8, sizeof bits);
                bits >>= hit % 8;
                if (kept > kSureBits)
                    bits = hitWords[hit / 64] >> hit % 64 | hitWords[hit / 64 + 1] << 1 << (63 - hit % 64);
                hit += kept;
                const std::uint64_t placed = deposit(bits, keep);
                count += static_cast<std::uint32_t>(__builtin_popcountll(placed));
                std::memcpy(out + w, &placed, sizeof placed);
            }
            return count;
        }
    };

    MaskRows(HaloScratch& haloScratch, RowSink& rowSink) : scratch(haloScratch), sink(rowSink) {}

    void reserve(std::size_t words)
    {
        constexpr std::size_t kPastEnd = 2; // a row is written 64 bits at a time
        sink.grow(sink, words + kPastEnd);
        sink.taskBegin = sink.out;
    }

    void finish() {}

    HaloScratch& scratch;
    RowSink& sink;
};

} // namespace
} // namespace vdb_nns

// A consumer of rows (search_rows-inl.h): the numbers of the nearest neighbors, so many of each query, in the order of the
// candidates. Their scores tell which those are; where two are too near to tell, and one of them has to go, exact arithmetic
// does. Knows nothing of where rows go (row_targets-inl.h). Internal linkage.
#pragma once

#include "cpu/row_targets-inl.h"
#include "cpu/search_rows-inl.h"
#include "cpu/sort_row-inl.h"

namespace vdb_nns {
namespace {

// Scores are the bits of negative floats: as unsigned numbers they fall with the distance.
inline float scoreOf(std::uint32_t bits)
{
    float score;
    std::memcpy(&score, &bits, sizeof score);
    return score;
}

// Cuts rows to the nearest `most`.
class NearestCut {
public:
    NearestCut(const SearchContext& context, const ExactPredicate& exact, HaloScratch& scratch)
        : mDoubt(context.sets.nearestDoubt), mExact(exact), mScratch(scratch)
    {
    }

    // Writes the nearest `most` of a row of more to `out`, which has room for a whole vector more. `scores` are changed.
    void cut(std::uint32_t query, const std::uint32_t* numbers, std::uint32_t* scores, std::uint32_t count,
             std::uint32_t most, std::uint32_t* out) const
    {
        const float last = scoreOf(lastKept(scores, count, most));
        const float surely = last - mDoubt, surelyNot = last + mDoubt;
        // Lanes past the end of the row must say no.
        Simd::store(scores + count, Simd::set(0));
        std::uint32_t sure = 0, doubtful = 0;
        const Simd::F below = Simd::set(surely), above = Simd::set(surelyNot);
        for (std::uint32_t i = 0; i < count; i += Simd::kLanes) {
            const Simd::F score = Simd::floatsOf(Simd::load(scores + i));
            const Simd::Mask isNegative = Simd::movesign(score);
            const Simd::Mask in = Simd::lessEqual(score, below) & isNegative;
            sure += static_cast<std::uint32_t>(__builtin_popcount(in));
            doubtful += static_cast<std::uint32_t>(
                __builtin_popcount(Simd::lessEqual(score, above) & isNegative & ~in));
        }
        if (sure + doubtful > most) {
            cutExactly(query, numbers, scores, count, surely, surelyNot, most - sure, out);
            return;
        }
        for (std::uint32_t i = 0; i < count; i += Simd::kLanes) {
            const Simd::F score = Simd::floatsOf(Simd::load(scores + i));
            const Simd::Mask in = Simd::lessEqual(score, above) & Simd::movesign(score);
            Simd::store(out, Simd::compress(Simd::load(numbers + i), Simd::order(in)));
            out += __builtin_popcount(in);
        }
    }

private:
    // The score of the last of the nearest.
    std::uint32_t lastKept(const std::uint32_t* scores, std::uint32_t count, std::uint32_t most) const
    {
        if (most == 1) {
            std::uint32_t nearest = 0;
            for (std::uint32_t i = 0; i < count; ++i) nearest = scores[i] > nearest ? scores[i] : nearest;
            return nearest;
        }
        std::uint32_t* const sorted = mScratch.sortedScores();
        sortRow(scores, count, sorted, mScratch.cutScratch());
        return sorted[count - most];
    }

    // Takes `wanted` of those between the two scores, the nearest.
    __attribute__((noinline)) void cutExactly(std::uint32_t query, const std::uint32_t* numbers,
                                              const std::uint32_t* scores, std::uint32_t count, float surely,
                                              float surelyNot, std::uint32_t wanted, std::uint32_t* out) const
    {
        std::uint32_t* const doubtful = mScratch.cutScratch();
        std::uint32_t doubts = 0;
        for (std::uint32_t i = 0; i < count; ++i) {
            const float score = scoreOf(scores[i]);
            if (score > surely && score <= surelyNot) doubtful[doubts++] = numbers[i];
        }
        selectNearest(query, doubtful, doubts, wanted);
        // Many are compared with the last of them, few are looked up, which is faster.
        const bool areFew = wanted <= kFew;
        const std::uint32_t last = areFew ? 0 : farthestOf(query, doubtful, wanted);
        const auto isTaken = [&](std::uint32_t number) {
            if (areFew) return contains(doubtful, wanted, number);
            return number == last || mExact.isNearer(mExact.state, query, number, last);
        };
        for (std::uint32_t i = 0; i < count; ++i) {
            const float score = scoreOf(scores[i]);
            if (score > surelyNot) continue;
            if (score > surely && !isTaken(numbers[i])) continue;
            *out++ = numbers[i];
        }
    }

    static constexpr std::uint32_t kFew = 64;

    std::uint32_t farthestOf(std::uint32_t query, const std::uint32_t* numbers, std::uint32_t count) const
    {
        std::uint32_t farthest = numbers[0];
        for (std::uint32_t i = 1; i < count; ++i) {
            if (mExact.isNearer(mExact.state, query, farthest, numbers[i])) farthest = numbers[i];
        }
        return farthest;
    }

    static bool contains(const std::uint32_t* numbers, std::uint32_t count, std::uint32_t number)
    {
        for (std::uint32_t i = 0; i < count; ++i) {
            if (numbers[i] == number) return true;
        }
        return false;
    }

    // Moves the nearest `wanted` of some candidates to the front: quickselect, with the median of three as pivot.
    void selectNearest(std::uint32_t query, std::uint32_t* numbers, std::uint32_t count,
                       std::uint32_t wanted) const
    {
        const auto isNearer = [&](std::uint32_t a, std::uint32_t b) {
            return mExact.isNearer(mExact.state, query, a, b);
        };
        const auto swap = [&](std::uint32_t i, std::uint32_t j) {
            const std::uint32_t number = numbers[i];
            numbers[i] = numbers[j];
            numbers[j] = number;
        };
        std::uint32_t begin = 0, end = count;
        while (end - begin > 1 && wanted > begin && wanted < end) {
            const std::uint32_t middle = begin + (end - begin) / 2;
            if (isNearer(numbers[middle], numbers[begin])) swap(middle, begin);
            if (isNearer(numbers[end - 1], numbers[begin])) swap(end - 1, begin);
            if (isNearer(numbers[end - 1], numbers[middle])) swap(end - 1, middle);
            swap(middle, end - 1);
            std::uint32_t place = begin; // of the pivot, once all before it are nearer
            for (std::uint32_t i = begin; i + 1 < end; ++i) {
                if (isNearer(numbers[i], numbers[end - 1])) swap(i, place++);
            }
            swap(place, end - 1);
            if (wanted <= place) {
                end = place;
            } else {
                begin = place + 1;
            }
        }
    }

    float mDoubt;
    const ExactPredicate& mExact;
    HaloScratch& mScratch;
};

template <typename Target>
struct NearestRows {
    static constexpr bool kByCandidate = false;

    struct Row {
        std::uint32_t *numbers, *scores;

        void take(Simd::I n, Simd::I s, Simd::Mask hits)
        {
            const Simd::Order order = Simd::order(hits);
            Simd::store(numbers, Simd::compress(n, order));
            Simd::store(scores, Simd::compress(s, order));
            numbers += __builtin_popcount(hits);
            scores += __builtin_popcount(hits);
        }
    };

    struct Group {
        NearestRows& rows;
        std::uint32_t slot; // of the next row

        Group(NearestRows& nearestRows, const Queries& queries, std::uint32_t)
            : rows(nearestRows), slot(queries.slot)
        {
        }

        void begin(int) {}
        Row first() const { return rows.emptyRow(0); }
        Row second() const { return rows.emptyRow(1); }

        std::uint32_t end(Row row) { return end(row, 0); }
        std::uint32_t endPair(Row a, Row b)
        {
            const std::uint32_t count = end(a, 0);
            return count + end(b, 1);
        }
        void finish() {}

    private:
        std::uint32_t end(Row row, int place)
        {
            const Row begin = rows.emptyRow(place);
            const auto found = static_cast<std::uint32_t>(row.numbers - begin.numbers);
            const std::uint32_t query = rows.context.sets.queries.number[slot];
            const std::uint32_t self = rows.context.sets.addsSelf && keepSelf(query, begin, found);
            const std::uint32_t nearest = rows.context.sets.nearest;
            const std::uint32_t count = found - self > nearest ? nearest + self : found;
            std::uint32_t* const out = rows.target.reserve(count + Simd::kLanes + RowSink::kPad);
            if (found > count) {
                rows.cut.cut(query, begin.numbers, begin.scores, found, count, out);
                ++rows.statistics.shortened;
            } else {
                for (std::uint32_t k = 0; k < count; k += Simd::kLanes) {
                    Simd::store(out + k, Simd::load(begin.numbers + k));
                }
            }
            const std::uint32_t* const next = rows.target.endOf(out, count);
            rows.note(slot++, rows.target.commit(static_cast<std::size_t>(next - out)), count);
            return count;
        }

        // Makes the query the nearest of its row, if it stands there.
        static bool keepSelf(std::uint32_t query, Row row, std::uint32_t count)
        {
            constexpr std::uint32_t kNearestScore = 0xff7fffffu; // the lowest float
            for (std::uint32_t i = 0; i < count; ++i) {
                if (row.numbers[i] != query) continue;
                row.scores[i] = kNearestScore;
                return true;
            }
            return false;
        }
    };

    NearestRows(const SearchContext& searchContext, const ExactPredicate& exact, HaloScratch& haloScratch,
                RowSink& rowSink, TaskStatistics& taskStatistics)
        : context(searchContext),
          scratch(haloScratch),
          sink(rowSink),
          statistics(taskStatistics),
          cut(searchContext, exact, haloScratch),
          target(haloScratch, rowSink)
    {
    }

    void finish() { target.finish(); }

    Row emptyRow(int place) const { return {scratch.uncutNumbers(place), scratch.uncutScores(place)}; }

    void note(std::uint32_t slot, std::uint32_t* row, std::uint32_t count)
    {
        sink.rowBegin[slot - sink.slotBase] = row;
        sink.rowCount[slot - sink.slotBase] = count;
        sink.nextSlot = slot + 1;
    }

    const SearchContext& context;
    HaloScratch& scratch;
    RowSink& sink;
    TaskStatistics& statistics;
    NearestCut cut;
    Target target;
};

} // namespace
} // namespace vdb_nns

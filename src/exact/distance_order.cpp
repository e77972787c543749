#include "exact/distance_order.h"

#include <algorithm>

namespace vdb_nns {

void DistanceOrder::order(std::uint32_t query, std::uint32_t* numbers, std::size_t count)
{
    if (count < 2) return;
    mRow.resize(count);
    double error = 0; // of any square of the row
    for (std::size_t k = 0; k < count; ++k) {
        const ExactTest::Square square = mExact->squareOf(query, numbers[k]);
        mRow[k] = {square.value, numbers[k]};
        error = std::max(error, square.error);
    }
    std::sort(mRow.begin(), mRow.end(), [](const Neighbor& a, const Neighbor& b) {
        return a.square != b.square ? a.square < b.square : a.number < b.number;
    });
    std::uint64_t exactPairs = 0;
    for (std::size_t begin = 0, end; begin < count; begin = end) {
        // Not "<=": of squares that are no numbers none is known to be larger.
        for (end = begin + 1; end < count && !(mRow[end].square - mRow[end - 1].square > 2 * error);) ++end;
        if (end - begin == 1) continue;
        std::sort(mRow.begin() + static_cast<std::ptrdiff_t>(begin),
                  mRow.begin() + static_cast<std::ptrdiff_t>(end), [&](const Neighbor& a, const Neighbor& b) {
                      return mExact->isNearer(query, a.number, b.number, exactPairs);
                  });
    }
    for (std::size_t k = 0; k < count; ++k) numbers[k] = mRow[k].number;
}

void DistanceOrder::keepNearest(std::uint32_t query, std::vector<std::uint32_t>& numbers, std::size_t most,
                                std::uint64_t& exactPairs)
{
    mSquares.clear();
    double error = 0; // of any square of the row
    for (const std::uint32_t number : numbers) {
        const ExactTest::Square square = mExact->squareOf(query, number);
        mSquares.push_back(square.value);
        error = std::max(error, square.error);
    }
    mRow.resize(numbers.size());
    for (std::size_t k = 0; k < numbers.size(); ++k) mRow[k] = {mSquares[k], numbers[k]};
    const auto last = mRow.begin() + static_cast<std::ptrdiff_t>(most) - 1;
    std::nth_element(mRow.begin(), last, mRow.end(),
                     [](const Neighbor& a, const Neighbor& b) { return a.square < b.square; });
    const double surely = last->square - 2 * error, surelyNot = last->square + 2 * error;
    // Not "<": squares of which nothing is known are in doubt, all of them.
    std::size_t sure = 0;
    mDoubtful.clear();
    for (const Neighbor& neighbor : mRow) {
        if (neighbor.square < surely) {
            ++sure;
        } else if (!(neighbor.square > surelyNot)) {
            mDoubtful.push_back(neighbor.number);
        }
    }
    const std::size_t wanted = most - sure;
    if (mDoubtful.size() > wanted) {
        std::nth_element(
            mDoubtful.begin(), mDoubtful.begin() + static_cast<std::ptrdiff_t>(wanted) - 1, mDoubtful.end(),
            [&](std::uint32_t a, std::uint32_t b) { return mExact->isNearer(query, a, b, exactPairs); });
        mDoubtful.resize(wanted);
        std::sort(mDoubtful.begin(), mDoubtful.end());
    } else {
        mDoubtful.clear(); // all of them are kept
    }
    std::size_t kept = 0;
    for (std::size_t k = 0; k < numbers.size(); ++k) {
        const bool isDoubtful = !(mSquares[k] < surely);
        if (mSquares[k] > surelyNot) continue;
        if (isDoubtful && !mDoubtful.empty() &&
            !std::binary_search(mDoubtful.begin(), mDoubtful.end(), numbers[k]))
            continue;
        numbers[kept++] = numbers[k];
    }
    numbers.resize(kept);
}

} // namespace vdb_nns

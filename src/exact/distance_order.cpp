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

} // namespace vdb_nns

#include "distance_order.h"

#include <algorithm>
#include <numeric>

namespace vdb_nns::cli {

void DistanceOrder::keepNearest(std::uint32_t query, std::uint64_t count, std::vector<std::uint32_t>& row)
{
    if (row.size() <= count) return;
    load(query, row);
    const auto last = mPlaces.begin() + static_cast<std::ptrdiff_t>(count);
    std::nth_element(mPlaces.begin(), last, mPlaces.end(),
                     [&](std::size_t a, std::size_t b) { return isNearer(query, a, b); });
    row.clear();
    for (auto place = mPlaces.begin(); place != last; ++place) row.push_back(mEntries[*place].number);
    std::sort(row.begin(), row.end());
}

void DistanceOrder::sort(std::uint32_t query, std::vector<std::uint32_t>& row)
{
    if (row.size() < 2) return;
    load(query, row);
    std::sort(mPlaces.begin(), mPlaces.end(),
              [&](std::size_t a, std::size_t b) { return isNearer(query, a, b); });
    row.clear();
    for (const std::size_t place : mPlaces) row.push_back(mEntries[place].number);
}

void DistanceOrder::load(std::uint32_t query, const std::vector<std::uint32_t>& row)
{
    mEntries.clear();
    for (const std::uint32_t number : row) mEntries.push_back({number, mJudge->distance(query, number), {}});
    mPlaces.resize(row.size());
    std::iota(mPlaces.begin(), mPlaces.end(), std::size_t(0));
}

bool DistanceOrder::isNearer(std::uint32_t query, std::size_t a, std::size_t b)
{
    Entry &one = mEntries[a], &other = mEntries[b];
    if (one.distance.high < other.distance.low) return true;
    if (other.distance.high < one.distance.low) return false;
    const int sign = compare(squareOf(query, one), squareOf(query, other));
    return sign != 0 ? sign < 0 : one.number < other.number;
}

const Dyadic& DistanceOrder::squareOf(std::uint32_t query, Entry& entry)
{
    if (!entry.square) entry.square = mJudge->squaredDistance(query, entry.number);
    return *entry.square;
}

} // namespace vdb_nns::cli

#include "bench/found_neighbors.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

namespace vdb_nns::cli {

void RowBuffers::row(std::uint32_t query, std::vector<std::uint32_t>& out) const
{
    const Place& place = places[query];
    if (place.count == 0) return out.clear(); // its buffer may not be there
    const std::uint32_t* const begin = buffers[place.buffer].data() + place.begin;
    out.assign(begin, begin + place.count);
}

void RowBuffers::visitRows(const RowVisitor& visit) const
{
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, places.size(), 1024), [&](const auto& range) {
        for (std::size_t query = range.begin(); query < range.end(); ++query) {
            const Place& place = places[query];
            if (place.count == 0) continue;
            visit(static_cast<std::uint32_t>(query),
                  {buffers[place.buffer].data() + place.begin, place.count});
        }
    });
}

std::uint64_t RowBuffers::pairCount() const
{
    std::uint64_t pairs = 0;
    for (const Place& place : places) pairs += place.count;
    return pairs;
}

std::uint64_t RowBuffers::bytes() const
{
    std::uint64_t bytes = places.size() * sizeof(Place);
    for (const std::vector<std::uint32_t>& buffer : buffers) bytes += buffer.size() * sizeof(std::uint32_t);
    return bytes;
}

} // namespace vdb_nns::cli

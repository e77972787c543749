#include "row_pass.h"

#include "throw_if_cancelled.h"
#include "vdb_nns/error.h"

#include <cmath>
#include <string>
#include <unordered_set>

namespace vdb_nns::cli {

namespace {

void checkRadii(Span<const double> radii, std::size_t count)
{
    if (radii.size() != count)
        throw InvalidInput("verify: " + std::to_string(radii.size()) + " radii for " + std::to_string(count) +
                           " particles");
}

} // namespace

void checkRadius(const SearchTerms& terms)
{
    const Radius& radius = terms.radius;
    if (radius.isOne()) {
        if (!(radius.value > 0 && std::isfinite(radius.value)))
            throw InvalidInput("verify: the radius must be positive and finite");
        return;
    }
    if (radius.mode != RadiusMode::kScatter) checkRadii(radius.ofQueries, terms.queries.view.size());
    if (radius.mode != RadiusMode::kGather) checkRadii(radius.ofCandidates, terms.candidates.view.size());
}

// By SplitMix64 and Floyd's method (Bentley, Programming Pearls): each subset is equally likely.
std::vector<std::uint32_t> drawSample(std::uint64_t size, std::uint64_t count, std::uint64_t seed)
{
    std::unordered_set<std::uint32_t> drawn;
    std::uint64_t state = seed;
    for (std::uint64_t last = size - count; last < size; ++last) {
        std::uint64_t z = (state += 0x9e3779b97f4a7c15ULL);
        z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ULL;
        z = (z ^ (z >> 27)) * 0x94d049bb133111ebULL;
        const auto number = static_cast<std::uint32_t>((z ^ (z >> 31)) % (last + 1));
        if (!drawn.insert(number).second) drawn.insert(static_cast<std::uint32_t>(last));
    }
    std::vector<std::uint32_t> sample(drawn.begin(), drawn.end());
    std::sort(sample.begin(), sample.end());
    return sample;
}

std::vector<std::vector<std::uint32_t>> searchAll(const SearchClouds& clouds, RowFinder& finder,
                                                  const std::uint32_t* queries, std::size_t count)
{
    constexpr std::size_t kTile = 4096; // candidates, which stay in the cache
    const std::size_t size = clouds.candidates->x.size();
    std::vector<std::vector<std::uint32_t>> found(count);
    for (std::size_t tile = 0; tile < size; tile += kTile) {
        const std::size_t end = std::min(size, tile + kTile);
        for (std::size_t q = 0; q < count; ++q) finder.findAmong(queries[q], tile, end, found[q]);
    }
    return found;
}

void RowCounter::done(std::uint64_t rows)
{
    Progress* const progress = mProgress.progress;
    if (!progress) return;
    const std::uint64_t all = mDone += rows;
    const double part = static_cast<double>(all) / static_cast<double>(mTotal);
    progress->update("verify", mProgress.from + part * (mProgress.to - mProgress.from));
    throwIfCancelled(progress);
}

} // namespace vdb_nns::cli

// TreeNSearch's octree in float32, points in their order. Cells are of its own choice with one radius. With
// radii of particles they are of the largest one: in those of its choice, 1.5 times the smallest, it loses
// pairs of 30 000 particles with radii 1:4, or dies by a segmentation fault (commit 61cf111).
#include "bench/methods/peers.h"

#if defined(VDB_NNS_HAVE_TREENSEARCH)

#include "machine.h"

#include <TreeNSearch>

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <cstddef>
#include <cstdint>
#include <limits>
#include <memory>
#include <stdexcept>
#include <utility>
#include <vector>

namespace vdb_nns::cli {
namespace {

// What an object of TreeNSearch holds after a run, until the next one.
class TreeNSearchLists final : public FoundNeighbors {
public:
    TreeNSearchLists(const tns::TreeNSearch& lists, std::size_t size) : mLists(lists), mSize(size) {}

    bool hasRows() const override { return true; }
    std::uint64_t count(std::uint32_t query) const override
    {
        return static_cast<std::uint64_t>(list(query).size());
    }
    void row(std::uint32_t query, std::vector<std::uint32_t>& out) const override
    {
        const tns::NeighborList neighbors = list(query);
        out.assign(neighbors.get_ptr(), neighbors.get_ptr() + neighbors.size());
    }
    void visitRows(const RowVisitor& visit) const override
    {
        tbb::parallel_for(tbb::blocked_range<std::size_t>(0, mSize, 1024), [&](const auto& range) {
            std::vector<std::uint32_t> numbers;
            for (std::size_t i = range.begin(); i < range.end(); ++i) {
                row(static_cast<std::uint32_t>(i), numbers);
                visit(static_cast<std::uint32_t>(i), {numbers.data(), numbers.size()});
            }
        });
    }

private:
    tns::NeighborList list(std::uint32_t query) const
    {
        return mLists.get_neighborlist(0, 0, static_cast<int>(query));
    }

    const tns::TreeNSearch& mLists;
    std::size_t mSize;
};

// Searches of like radii keep their buffers.
class TreeNSearchPeer final : public MethodWithResult {
public:
    MethodRun run(const ParticleView& view, double radius, const ProgressSpan& span) override
    {
        return runSets({view, radius}, span);
    }

    MethodRun runSets(const SetSearch& search, const ProgressSpan& span) override
    {
        discard();
        span.printer.begin("search", span.begin, span.end);
        const ParticleView& view = search.queries.view;
        if (view.size() > static_cast<std::size_t>(std::numeric_limits<int>::max()))
            throw std::runtime_error("TreeNSearch counts points by int");
        std::vector<float> xyz = worldPositions<float>(view), radii;
        const Span<const double> own = search.radius.ofQueries;
        for (const double radius : own) radii.push_back(static_cast<float>(radius));
        const auto count = static_cast<int>(view.size());

        MethodRun result;
        if (count == 0) { // it wants points
            mFound = std::make_unique<RowBuffers>();
            return result;
        }
        const double largest = search.largestRadius();
        if (!mSearch || mHasRadii != !radii.empty() || mLargest != largest) { // cells can be set once
            mSearch = std::make_unique<tns::TreeNSearch>();
            mHasRadii = !radii.empty();
            mLargest = largest;
            mHasRadii ? mSearch->add_point_set(xyz.data(), radii.data(), count)
                      : mSearch->add_point_set(xyz.data(), count);
            if (mHasRadii) mSearch->set_cell_size(static_cast<float>(largest));
            mSearch->set_active_search(0, 0, true);
        }
        mSearch->set_n_threads(tbb::this_task_arena::max_concurrency());
        mHasRadii ? mSearch->resize_point_set(0, xyz.data(), radii.data(), count)
                  : mSearch->resize_point_set(0, xyz.data(), count);
        if (mHasRadii) {
            mSearch->set_symmetric_search(search.radius.mode == RadiusMode::kSymmetric);
        } else {
            mSearch->set_search_radius(static_cast<float>(search.radius.value));
        }
        const Stopwatch watch;
        mSearch->run();
        result.searchSeconds = watch.seconds();
        for (int i = 0; i < count; ++i)
            result.pairs += static_cast<std::uint64_t>(mSearch->get_neighborlist(0, 0, i).size());
        result.listBytes = mSearch->get_neighborlist_n_bytes();
        mFound = std::make_unique<TreeNSearchLists>(*mSearch, view.size());
        return result;
    }

private:
    std::unique_ptr<tns::TreeNSearch> mSearch;
    bool mHasRadii = false;
    double mLargest = 0; // radius
};

} // namespace

bool hasTreeNSearch()
{
    return true;
}

std::unique_ptr<Method> makeTreeNSearchPeer()
{
    return std::make_unique<TreeNSearchPeer>();
}

} // namespace vdb_nns::cli

#else

namespace vdb_nns::cli {

bool hasTreeNSearch()
{
    return false;
}

std::unique_ptr<Method> makeTreeNSearchPeer()
{
    return nullptr;
}

} // namespace vdb_nns::cli

#endif

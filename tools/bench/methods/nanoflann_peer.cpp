// nanoflann's tree in three dimensions, as its examples use it. A neighbor is nearer than the radius, not at
// it; of the nearest, which are found without a radius, those at it are kept.
#include "bench/methods/peers.h"

#if defined(VDB_NNS_HAVE_NANOFLANN)

#include "machine.h"

#include <tbb/blocked_range.h>
#include <tbb/enumerable_thread_specific.h>
#include <tbb/parallel_for.h>

#include <nanoflann.hpp>

#include <optional>
#include <utility>

namespace vdb_nns::cli {
namespace {

// Of 10, 15, 20, 30 and 50, on 200 000 particles of block, clusters and spray with 2 threads: never more than 6 % behind the
// best of them, which is no other one everywhere.
constexpr std::size_t kLeafSize = 20;

// How nanoflann hands out hits and takes its parameters; version 1.5 gave both a new type.
#if NANOFLANN_VERSION >= 0x150
template <typename Real>
using Hit = nanoflann::ResultItem<std::uint32_t, Real>;
const nanoflann::SearchParameters kExactUnsorted(0, false);
#else
template <typename Real>
using Hit = std::pair<std::uint32_t, Real>;
const nanoflann::SearchParams kExactUnsorted(32, 0, false); // the first one does nothing
#endif

// What nanoflann asks of a set of points; the names are its.
template <typename Real>
struct TreePoints {
    std::vector<Real> xyz;

    std::size_t kdtree_get_point_count() const { return xyz.size() / 3; }
    Real kdtree_get_pt(std::size_t i, std::size_t axis) const { return xyz[3 * i + axis]; }
    template <typename Box>
    bool kdtree_get_bbox(Box&) const
    {
        return false; // it finds the box by itself
    }
};

template <typename Real>
class NanoflannPeer final : public RowMethod {
private:
    using Points = TreePoints<Real>;
    using Tree = nanoflann::KDTreeSingleIndexAdaptor<nanoflann::L2_Simple_Adaptor<Real, Points>, Points, 3,
                                                     std::uint32_t>;
    struct Worker {
        explicit Worker(RowPool& pool) : rows(pool) {}

        RowWriter rows;
        std::vector<Hit<Real>> hits;
        std::vector<std::uint32_t> numbers; // of the nearest
        std::vector<Real> squares;
    };

    void search(const SetSearch& sets, MethodRun& result) override
    {
        Members<Real> members = membersOf<Real>(sets.candidates);
        Points points{std::move(members.xyz)};
        const bool isSame = sets.isOneSet() && sets.candidates.chosen.empty();
        const std::vector<Real> others =
            isSame ? std::vector<Real>() : worldPositions<Real>(sets.queries.view);
        const std::vector<Real>& queries = isSame ? points.xyz : others;
        const Stopwatch treeWatch;
        Tree tree(3, points, nanoflann::KDTreeSingleIndexAdaptorParams(kLeafSize));
        result.gridSeconds = treeWatch.seconds();
        result.structureBytes = tree.usedMemory(tree);

        const Stopwatch searchWatch;
        for (Worker& worker : mWorkers) worker.rows.restart();
        const std::size_t count = sets.queries.view.size();
        tbb::parallel_for(tbb::blocked_range<std::size_t>(0, count, 512), [&](const auto& range) {
            throwIfStopped();
            Worker& worker = mWorkers.local();
            for (std::size_t i = range.begin(); i < range.end(); ++i) {
                if (!sets.hasQuery(i)) continue;
                const Real radius = static_cast<Real>(sets.queryRadius(i));
                const Real* const at = queries.data() + 3 * i;
                const std::uint32_t self = sets.isOneSet() ? static_cast<std::uint32_t>(i) : kNobody;
                if (sets.nearest > 0) {
                    findNearest(tree, at, sets.nearest, self != kNobody, worker);
                    writeNearest(static_cast<std::uint32_t>(i), self, sets.nearest, radius * radius, members,
                                 worker);
                    continue;
                }
                worker.hits.clear();
                tree.radiusSearch(at, radius * radius, worker.hits, kExactUnsorted);
                writeRow(static_cast<std::uint32_t>(i), self, members, worker);
            }
        });
        for (const Worker& worker : mWorkers) result.pairs += worker.rows.pairs();
        result.searchSeconds = searchWatch.seconds();
    }

    static constexpr std::uint32_t kNobody = ~std::uint32_t(0); // a view has fewer particles

    static void writeRow(std::uint32_t query, std::uint32_t self, const Members<Real>& members,
                         Worker& worker)
    {
        std::uint32_t* const row = worker.rows.reserve(worker.hits.size());
        std::uint32_t count = 0;
        for (const auto& hit : worker.hits) {
            const std::uint32_t number = members.number(hit.first);
            if (number != self) row[count++] = number;
        }
        worker.rows.commit(query, count);
    }

    // One more where the query itself may be among them.
    static void findNearest(const Tree& tree, const Real* at, std::uint32_t nearest, bool hasSelf,
                            Worker& worker)
    {
        const std::size_t most = std::size_t(nearest) + (hasSelf ? 1 : 0);
        worker.numbers.resize(most);
        worker.squares.resize(most);
        const std::size_t found = tree.knnSearch(at, most, worker.numbers.data(), worker.squares.data());
        worker.numbers.resize(found);
    }

    static void writeNearest(std::uint32_t query, std::uint32_t self, std::uint32_t nearest,
                             Real radiusSquared, const Members<Real>& members, Worker& worker)
    {
        std::uint32_t* const row = worker.rows.reserve(worker.numbers.size());
        std::uint32_t count = 0;
        for (std::size_t k = 0; k < worker.numbers.size() && count < nearest; ++k) {
            const std::uint32_t number = members.number(worker.numbers[k]);
            if (number != self && worker.squares[k] <= radiusSquared) row[count++] = number;
        }
        worker.rows.commit(query, count);
    }

    tbb::enumerable_thread_specific<Worker> mWorkers{[this] { return Worker(mPool); }};
};

} // namespace

bool hasNanoflann()
{
    return true;
}

std::unique_ptr<Method> makeNanoflannPeer(bool inDoubles)
{
    if (inDoubles) return std::make_unique<NanoflannPeer<double>>();
    return std::make_unique<NanoflannPeer<float>>();
}

} // namespace vdb_nns::cli

#else

namespace vdb_nns::cli {

bool hasNanoflann()
{
    return false;
}

std::unique_ptr<Method> makeNanoflannPeer(bool)
{
    return nullptr;
}

} // namespace vdb_nns::cli

#endif

// OpenVDB's own search: a PointIndexGrid over a list of points, and a PointIndexFilter for each query. A neighbor is nearer
// than the radius, not at it.
#include "bench/methods/peers.h"
#include "machine.h"

#include <openvdb/openvdb.h>
#include <openvdb/tools/PointIndexGrid.h>

#include <tbb/blocked_range.h>
#include <tbb/enumerable_thread_specific.h>
#include <tbb/parallel_for.h>

namespace vdb_nns::cli {
namespace {

// Of 0.5, 1, 1.5, 2 and 3, on 200 000 particles of block, clusters and spray with 2 threads: the fastest or within 3 % of
// it; on block 0.5 and 1.5 take 1.4 times as long.
constexpr double kVoxelsPerRadius = 1;

// What OpenVDB asks of a list of points; the names are its.
struct PointList {
    using PosType = openvdb::Vec3R;

    std::vector<openvdb::Vec3R> points;

    std::size_t size() const { return points.size(); }
    void getPos(std::size_t i, openvdb::Vec3R& at) const { at = points[i]; }
};

struct Hits {
    const Members<double>* members;
    std::uint32_t self;
    std::vector<std::uint32_t> numbers;

    void operator()(double, std::size_t i)
    {
        const std::uint32_t number = members->number(static_cast<std::uint32_t>(i));
        if (number != self) numbers.push_back(number);
    }
};

class OpenVdbPeer final : public RowMethod {
private:
    using Filter = openvdb::tools::PointIndexFilter<PointList>;

    struct Worker {
        explicit Worker(RowPool& pool) : rows(pool) {}

        RowWriter rows;
        Hits hits;
    };

    void search(const SetSearch& sets, MethodRun& result) override
    {
        constexpr std::uint32_t kNobody = ~std::uint32_t(0); // a view has fewer particles
        const Members<double> members = membersOf<double>(sets.candidates);
        const double radius = sets.largestRadius();
        PointList list;
        list.points.resize(members.xyz.size() / 3);
        for (std::size_t i = 0; i < list.points.size(); ++i)
            list.points[i] =
                openvdb::Vec3R(members.xyz[3 * i], members.xyz[3 * i + 1], members.xyz[3 * i + 2]);
        const Stopwatch gridWatch;
        const openvdb::tools::PointIndexGrid::Ptr grid =
            openvdb::tools::createPointIndexGrid<openvdb::tools::PointIndexGrid>(list,
                                                                                 radius / kVoxelsPerRadius);
        result.gridSeconds = gridWatch.seconds();
        result.structureBytes = grid->memUsage();

        const Stopwatch searchWatch;
        for (Worker& worker : mWorkers) worker.rows.restart();
        const Filter original(list, grid->tree(), grid->transform());
        tbb::enumerable_thread_specific<Filter> filters([&original] { return Filter(original); });
        const ParticleView& queries = sets.queries.view;
        tbb::parallel_for(tbb::blocked_range<std::size_t>(0, queries.size(), 512), [&](const auto& range) {
            throwIfStopped();
            Worker& worker = mWorkers.local();
            Filter& filter = filters.local();
            worker.hits.members = &members;
            for (std::size_t i = range.begin(); i < range.end(); ++i) {
                if (!sets.hasQuery(i)) continue;
                const auto query = static_cast<std::uint32_t>(i);
                const Vec3d at = queries.worldPosition(i);
                worker.hits.self = sets.isOneSet() ? query : kNobody;
                worker.hits.numbers.clear();
                filter.searchAndApply(openvdb::Vec3R(at[0], at[1], at[2]), sets.queryRadius(i), worker.hits);
                worker.rows.append(query, worker.hits.numbers.data(), worker.hits.numbers.size());
            }
        });
        for (const Worker& worker : mWorkers) result.pairs += worker.rows.pairs();
        result.searchSeconds = searchWatch.seconds();
    }

    tbb::enumerable_thread_specific<Worker> mWorkers{[this] { return Worker(mPool); }};
};

} // namespace

std::unique_ptr<Method> makeOpenVdbPeer()
{
    return std::make_unique<OpenVdbPeer>();
}

} // namespace vdb_nns::cli

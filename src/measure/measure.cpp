// A pass over the neighbors that makes measures, and the passes that some need besides.
#include "vdb_nns/measure.h"

#include "measure/averaged_values.h"
#include "measure/cluster_pairs.h"
#include "measure/measure_list.h"
#include "measure/measure_memory.h"
#include "measure/padded_rows.h"
#include "measure/pair_positions.h"
#include "measure/results.h"
#include "measure/row_batch.h"
#include "search/engine_state.h"
#include "search/visit_tasks.h"
#include "util/ieee_mode.h"
#include "util/isolate.h"
#include "util/wall_clock.h"
#include "vdb_nns/error.h"
#include "vdb_nns/search.h"

#include <tbb/enumerable_thread_specific.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <memory>
#include <optional>

namespace vdb_nns {

namespace {

// --------------------------------------------------------------------------------------------------- checks

void checkMasses(Span<const double> masses, std::uint64_t candidates)
{
    if (masses.empty()) return;
    if (masses.size() != candidates)
        throw InvalidInput(std::to_string(masses.size()) + " masses for " + std::to_string(candidates) +
                           " candidates: give one a candidate");
    const auto bad =
        std::find_if(masses.begin(), masses.end(), [](double m) { return !(m >= 0) || !std::isfinite(m); });
    if (bad != masses.end())
        throw InvalidInput("the mass " + std::to_string(*bad) + " of candidate " +
                           std::to_string(bad - masses.begin()) +
                           " is negative or not finite: masses are finite and not negative");
}

void checkAttributes(const std::vector<Measure>& measures, const MeasureOptions& options,
                     std::uint64_t candidates)
{
    for (const Measure& measure : measures) {
        if (measure.kind != MeasureKind::kAverage) continue;
        for (const PointAttribute& attribute : options.attributes) {
            if (attribute.name != measure.attribute || attribute.count == candidates) continue;
            throw InvalidInput("the attribute '" + attribute.name + "' has " +
                               std::to_string(attribute.count) + " values for " + std::to_string(candidates) +
                               " candidates: give one a candidate");
        }
    }
}

void checkClusters(const SearchSets& sets, const SearchOptions& search)
{
    const SearchSetsData& data = sets.data();
    if (search.nearest > 0)
        throw InvalidInput(
            "clusters are made of whole lists, not of the nearest neighbors: leave one of the two out");
    if (!data.areSameParticles() || !data.candidateChosen.empty() || !data.queryChosen.empty())
        throw InvalidInput("clusters are those of all particles: leave queries and groups out");
}

// --------------------------------------------------------------------------------------------------- passes

// What one thread of a pass over a search has.
struct ThreadPass {
    RowBatch batch;
    LeafSums leaf;
};

class PassCallback final : public RowCallback {
public:
    PassCallback(const SearchRun& run, const SearchTask& task, ThreadPass& pass, bool wantsRows,
                 ClusterPairs* clusters, std::uint32_t* rowCount)
        : mRun(run),
          mTask(task),
          mPass(pass),
          mWantsRows(wantsRows),
          mClusters(clusters),
          mRowCount(rowCount),
          mMode()
    {
    }

    void take(const VisitedRows& rows) override
    {
        const std::uint32_t* const queries = &mRun.queries.number[rows.firstSlot];
        std::copy_n(rows.counts, rows.rows, mRowCount + rows.firstSlot);
        if (rows.areHalf) {
            takeOnce(queries, rows);
        } else if (mWantsRows) {
            mPass.batch.take(queries, rows);
        }
        if (!mClusters) return;
        rows.forEach([&](std::uint32_t slot, const std::uint32_t* neighbors, std::uint32_t count) {
            mClusters->add(mRun.queries.number[slot], neighbors, count);
        });
    }

    bool finish() override
    {
        if (!mAreHalf) return true;
        return mPass.leaf.finish(&mRun.queries.number[mTask.firstSlot], mRowCount + mTask.firstSlot);
    }

private:
    void takeOnce(const std::uint32_t* queries, const VisitedRows& rows)
    {
        if (!mAreHalf) mPass.leaf.begin(mTask.firstSlot, mTask.endSlot - mTask.firstSlot);
        mAreHalf = true;
        mPass.batch.takeOnce(queries, rows, mPass.leaf);
    }

    const SearchRun& mRun;
    const SearchTask& mTask;
    ThreadPass& mPass;
    bool mWantsRows, mAreHalf = false;
    ClusterPairs* mClusters;
    std::uint32_t* mRowCount;
    const IeeeMode mMode; // of the whole task
};

// What one thread of a pass over lists has.
struct ListPass {
    RowBatch batch;
    PaddedRows rows;
};

// One call of measure().
class MeasureJob {
public:
    // `lists`: of the sets; null: they are searched.
    MeasureJob(SearchEngine& engine, EngineState& state, const SearchSets& sets, const NeighborLists* lists,
               const std::vector<std::string>& names, const MeasureOptions& options)
        : mEngine(engine),
          mState(state),
          mOptions(options),
          mSearch(searchOf(options, lists)),
          mLists(lists),
          mSets(setsWithin(sets, options.search.radius)),
          mMeasures(measuresOf(names)),
          mCancel(options.search.progress, "measure")
    {
        checkMeasureOptions(options);
        checkOptions(mSearch);
        checkMasses(options.masses, mSets.columnCount());
        checkAttributes(mMeasures, options, mSets.columnCount());
        checkMemory();
    }

    Measured run()
    {
        MeasureResults results(mMeasures, mOptions, mSets.rowCount(), mSets.columnCount(), mState.results);
        mTargets = &results.targets();
        if (mTargets->wantsClusters()) checkClusters(mSets, mSearch);
        Measured measured;
        measured.counts =
            mTargets->wantsRows() || mTargets->wantsClusters() ? pass(measured.skipped) : countNeighbors();
        if (mTargets->stretch) finishPca();
        if (mTargets->nearest) findNearest();
        writeCounts(measured.counts);
        measured.values = results.take();
        return measured;
    }

private:
    static SearchOptions searchOf(const MeasureOptions& options, const NeighborLists* lists)
    {
        SearchOptions search = options.search;
        if (lists) search.nearest = lists->data().nearest;
        search.encoding = Encoding::kNone;
        search.includeSelf = false;
        search.radius = 0; // the sets are within it
        return search;
    }

    void checkMemory()
    {
        const std::uint64_t needed = mSets.bytes() + MeasureMemory(mMeasures, mOptions).bytes(mSets);
        const std::uint64_t allowed =
            mSearch.hostMemoryBytes ? mSearch.hostMemoryBytes : mSets.bytes() + availableMemoryBytes();
        if (needed > allowed)
            throw CapacityError("measures need " + std::to_string(needed) + " bytes of memory, allowed are " +
                                    std::to_string(allowed) +
                                    ": ask for fewer measures, or allow more host memory",
                                needed, allowed);
        const std::uint64_t more = PairPositions::bytesMoreAsDoubles(mSets.queries(), mSets.candidates());
        mMayBeDoubles = mSearch.hostMemoryBytes == 0 && more <= allowed - needed;
    }

    // Positions, which rows have left the shares of their means for, and what points have that are no ellipsoids.
    void finishPca()
    {
        const PcaOptions& pca = mOptions.pca;
        const MeasureTargets& targets = *mTargets;
        const ParticleView& view = mSets.queries();
        forEachChunk(view.size(), mCancel, [&](std::size_t begin, std::size_t end) {
            for (std::size_t i = begin; i < end; ++i) {
                const Vec3d world = view.worldPosition(i);
                for (std::size_t k = 0; k < 3; ++k)
                    targets.pws[3 * i + k] = pca.average > 0 ? world[k] + targets.pws[3 * i + k] : world[k];
                if (targets.ellipsoids[i]) continue;
                std::fill_n(targets.stretch + 3 * i, 3, static_cast<float>(pca.stretch));
                for (std::size_t k = 0; k < 9; ++k) targets.xform[9 * i + k] = k % 4 == 0 ? 1 : 0;
            }
        });
    }

    NeighborLists countNeighbors() { return mLists ? *mLists : mEngine.search(mSets, mSearch); }

    NeighborLists pass(std::vector<Measured::Skipped>& skipped)
    {
        const double start = wallSeconds();
        std::optional<ClusterPairs> clusters;
        if (mTargets->wantsClusters()) {
            std::optional<CorePoints> cores;
            if (mOptions.minNeighbors) cores.emplace(countNeighbors(), *mOptions.minNeighbors, mCancel);
            clusters.emplace(mSets.rowCount(), std::move(cores), mState.clusters);
        }
        std::vector<std::unique_ptr<AveragedValues>> values;
        const std::vector<AveragedAttribute> averaged = readAveraged(values, skipped);
        PairPositions positions;
        if (mTargets->wantsRows())
            positions.read(mSets.queries(), mSets.candidates(), mSets.data().largestRadius, mMayBeDoubles,
                           mCancel, mState.positions);

        const double radius = mSets.data().radius.isOne() ? mSets.radius() : mSets.data().largestRadius;
        const RowMeasures measures{
            mSets.data(), kernelsFor(mSearch.simd).measure, positions, mOptions, *mTargets, averaged, radius};
        ClusterPairs* const pairs = clusters ? &*clusters : nullptr;
        const NeighborLists counts =
            mLists ? passOver(*mLists, measures, pairs) : passSearching(measures, positions, pairs);
        if (clusters) {
            const NeighborListsData& lists = counts.data();
            clusters->finish(*mTargets, mSets.rowCount(), mCancel,
                             [&](std::size_t i) { return lists.slotOf[i] != kNoSlot || isFinite(i); });
        }
        // Under a bound the memory is better spent on what is written.
        for (int k = 0; k < 2 && mSearch.hostMemoryBytes > 0; ++k) {
            mState.positions[k] = PageArray<char>();
            mState.clusters[k] = PageArray<char>();
        }
        if (!mLists) mState.statistics.searchSeconds = wallSeconds() - start;
        return counts;
    }

    NeighborLists passOver(const NeighborLists& lists, const RowMeasures& measures,
                           ClusterPairs* clusters) const
    {
        const bool wantsRows = mTargets->wantsRows();
        const auto handOut = [&](ListPass& pass) {
            pass.rows.handOut([&](const std::uint32_t* queries, const VisitedRows& rows) {
                if (wantsRows) pass.batch.take(queries, rows);
                if (!clusters) return;
                rows.forEach([&](std::uint32_t row, const std::uint32_t* neighbors, std::uint32_t count) {
                    clusters->add(queries[row], neighbors, count);
                });
            });
        };
        tbb::enumerable_thread_specific<ListPass> passes([&] { return ListPass{RowBatch(measures), {}}; });
        std::atomic<std::uint64_t> done{0};
        const double all = static_cast<double>(std::max<std::size_t>(1, lists.size()));
        lists.visitRows([&](std::uint32_t query, Span<const std::uint32_t> neighbors) {
            ListPass& pass = passes.local();
            pass.rows.add(query, neighbors);
            if (!pass.rows.isFull()) return;
            mCancel.update(static_cast<double>(done += pass.rows.count()) / all);
            handOut(pass);
        });
        for (ListPass& pass : passes) handOut(pass);
        return lists;
    }

    NeighborLists passSearching(const RowMeasures& measures, PairPositions& positions, ClusterPairs* clusters)
    {
        const SearchRuns runs(mSets, mSearch);
        const std::shared_ptr<NeighborListsData> result = mState.beginLists(mSets, Encoding::kNone, mSearch);
        mState.beginStatistics(mSearch);
        ChunkPool pool(std::move(result->chunks));
        mState.allowRows(runs, mSearch, 0, *result, pool);
        tbb::enumerable_thread_specific<ThreadPass> passes([&] {
            return ThreadPass{RowBatch(measures), LeafSums(measures)};
        });
        runs.forEach([&](const SearchRun& run) {
            visitTasks(mState, run, kindOfRows(run, measures, positions),
                       [&](const SearchRun& part, const SearchTask& task, ThreadState& state) {
                           if (mTargets->wantsRows()) {
                               state.halo.records = static_cast<const char*>(positions.candidates());
                               state.halo.recordBytes = positions.recordBytes();
                           }
                           return PassCallback(part, task, passes.local(), mTargets->wantsRows(), clusters,
                                               result->rowCount.data() + part.firstRow);
                       });
        });
        mState.finishLists(runs, pool, *result);
        mState.lists = result;
        return NeighborLists(result);
    }

    // Where it is enough to see a pair once, or one of a leaf once; then particles are told their slots.
    RowKind kindOfRows(const SearchRun& run, const RowMeasures& measures, PairPositions& positions) const
    {
        if (!mTargets->wantsRows()) return run.kernels.smaller ? RowKind::kSmaller : RowKind::kVisit;
        if (!run.kernels.half || !LeafSums::suffice(measures)) return RowKind::kVisit;
        positions.setSlots(run.queries.number, run.queries.particleCount(), mCancel);
        return RowKind::kHalf;
    }

    // By attribute of the options.
    std::vector<AveragedAttribute> readAveraged(std::vector<std::unique_ptr<AveragedValues>>& values,
                                                std::vector<Measured::Skipped>& skipped) const
    {
        std::vector<AveragedAttribute> averaged(mOptions.attributes.size());
        for (const MeasureTargets::Average& average : mTargets->averages) {
            const PointAttribute& attribute = mOptions.attributes[average.attribute];
            values.push_back(std::make_unique<AveragedValues>(attribute, mCancel));
            averaged[average.attribute] = values.back()->view();
            if (values.back()->skipped() > 0) skipped.push_back({attribute.name, values.back()->skipped()});
        }
        return averaged;
    }

    void findNearest()
    {
        SearchOptions one = mSearch;
        one.nearest = 1;
        const MeasureTargets& targets = *mTargets;
        mEngine.visitRows(
            mSets,
            [&targets](std::uint32_t query, Span<const std::uint32_t> neighbors) {
                if (!neighbors.empty()) putInteger(targets.nearest, targets.areWide, query, neighbors[0]);
            },
            one);
    }

    bool isFinite(std::size_t i) const
    {
        const StoredPosition p = mSets.queries().stored(i);
        return std::isfinite(p.offset[0]) && std::isfinite(p.offset[1]) && std::isfinite(p.offset[2]);
    }

    void writeCounts(const NeighborLists& counts)
    {
        const MeasureTargets& targets = *mTargets;
        if (!targets.count && !targets.isolated && !targets.nonfinite) return;
        const Span<const std::uint8_t> chosen = mSets.data().queryChosen;
        forEachChunk(counts.size(), mCancel, [&](std::size_t begin, std::size_t end) {
            for (std::size_t i = begin; i < end; ++i) {
                const std::uint32_t count = counts.count(i);
                if (targets.count) targets.count[i] = static_cast<std::int32_t>(count);
                if (count > 0) continue;
                const bool finite = (targets.isolated || targets.nonfinite) && isFinite(i);
                if (targets.isolated) targets.isolated[i] = finite && (chosen.empty() || chosen[i]);
                if (targets.nonfinite) targets.nonfinite[i] = !finite;
            }
        });
    }

    SearchEngine& mEngine;
    EngineState& mState;
    const MeasureOptions& mOptions;
    const SearchOptions mSearch;
    const NeighborLists* const mLists;
    const SearchSets mSets;
    const std::vector<Measure> mMeasures;
    const CancelCheck mCancel;
    const MeasureTargets* mTargets = nullptr;
    bool mMayBeDoubles = false; // positions
};

} // namespace

Measured SearchEngine::measure(const SearchSets& sets, const std::vector<std::string>& measures,
                               const MeasureOptions& options)
{
    return isolatedIeee([&] { return MeasureJob(*this, *mImpl, sets, nullptr, measures, options).run(); });
}

Measured SearchEngine::measure(const NeighborLists& lists, const std::vector<std::string>& measures,
                               const MeasureOptions& given)
{
    if (lists.encoding() == Encoding::kNone || lists.data().hasSelf)
        throw InvalidInput(
            "measures are made of lists of neighbors: search with encoding index or mask, and without "
            "includeSelf");
    MeasureOptions options = given;
    options.search.radius = lists.sets().data().radius.isOne() ? lists.radius() : 0;
    return isolatedIeee(
        [&] { return MeasureJob(*this, *mImpl, lists.sets(), &lists, measures, options).run(); });
}

PointValues measure(const ParticleView& view, double radius, const std::vector<std::string>& measures,
                    const MeasureOptions& options)
{
    SearchEngine engine;
    return engine.measure(engine.buildGrid(view, radius, options.search), measures, options).values;
}

} // namespace vdb_nns

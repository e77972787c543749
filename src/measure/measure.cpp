// A pass over the neighbors that makes measures, and the passes that some need besides.
#include "vdb_nns/measure.h"

#include "measure/clusters.h"
#include "measure/measure_list.h"
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

#include <tbb/blocked_range.h>
#include <tbb/enumerable_thread_specific.h>
#include <tbb/parallel_for.h>
#include <tbb/parallel_reduce.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <limits>
#include <memory>
#include <optional>

namespace vdb_nns {

namespace {

constexpr std::size_t kChunk = 8192;

template <typename F>
void forEachChunk(std::size_t count, const CancelCheck& cancel, F&& f)
{
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, count, kChunk), [&](const auto& range) {
        cancel.check();
        f(range.begin(), range.end());
    });
}

// ----------------------------------------------------------------------------------------------- attributes

// The numbers of an attribute as kernels read them, and which of its values are finite.
class AveragedValues {
public:
    AveragedValues(const PointAttribute& attribute, const CancelCheck& cancel)
        : mCount(static_cast<std::size_t>(attribute.count)), mCancel(cancel)
    {
        mView.isVector = attributeWidth(attribute.type) == 3;
        const void* const from = attribute.values.get();
        switch (attribute.type) {
        case AttributeType::kFloat:
        case AttributeType::kVec3s:
            read<float>(static_cast<const float*>(from));
            break;
        case AttributeType::kDouble:
        case AttributeType::kVec3d:
            read<double>(static_cast<const double*>(from));
            break;
        case AttributeType::kInt32:
            read<double>(static_cast<const std::int32_t*>(from));
            break;
        case AttributeType::kInt64:
            read<double>(static_cast<const std::int64_t*>(from));
            break;
        case AttributeType::kMat3s:
            break; // averageType() refuses it
        }
    }

    AveragedAttribute view() const { return mView; }
    std::uint64_t skipped() const { return mSkipped; }

private:
    template <typename To, typename From>
    void read(const From* from)
    {
        const std::size_t width = mView.isVector ? 3 : 1, step = mView.isVector ? 4 : 1;
        mView.isDouble = sizeof(To) == sizeof(double);
        mValues.resizeDiscarding(mCount * step * sizeof(To));
        To* const to = reinterpret_cast<To*>(mValues.data());
        // Zeros where one of its numbers is not finite. Returns whether all are.
        const auto copyValue = [=](std::size_t i) {
            bool isFinite = true;
            for (std::size_t c = 0; c < width; ++c) {
                to[step * i + c] = static_cast<To>(from[width * i + c]);
                isFinite &= std::isfinite(to[step * i + c]);
            }
            for (std::size_t c = isFinite ? width : 0; c < step; ++c) to[step * i + c] = 0;
            return isFinite;
        };
        std::atomic<std::uint64_t> skipped{0};
        forEachChunk(mCount, mCancel, [&](std::size_t begin, std::size_t end) {
            std::uint64_t bad = 0;
            for (std::size_t i = begin; i < end; ++i) bad += !copyValue(i);
            skipped += bad;
        });
        mSkipped = skipped;
        mView.values = to;
        if (mSkipped == 0) return;
        mValid.resizeDiscarding(mCount);
        forEachChunk(mCount, mCancel, [&](std::size_t begin, std::size_t end) {
            for (std::size_t i = begin; i < end; ++i) mValid[i] = copyValue(i) ? 1 : 0;
        });
        mView.valid = mValid.data();
    }

    const std::size_t mCount;
    const CancelCheck& mCancel;
    PageArray<char> mValues;
    PageArray<double> mValid;
    AveragedAttribute mView;
    std::uint64_t mSkipped = 0;
};

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

// ------------------------------------------------------------------------------------------------- clusters

// Which particles are core points, and what the others are near to.
class CorePoints {
public:
    CorePoints(const NeighborLists& counts, std::uint32_t minNeighbors, const CancelCheck& cancel)
        : mIsCore(counts.size()), mNearest(counts.size() * sizeof(Number))
    {
        Number* const nearest = static_cast<Number*>(mNearest.data());
        forEachChunk(counts.size(), cancel, [&](std::size_t begin, std::size_t end) {
            for (std::size_t i = begin; i < end; ++i) {
                mIsCore[i] = counts.count(i) >= minNeighbors;
                new (nearest + i) Number(kNone);
            }
        });
    }

    static constexpr std::uint32_t kNone = 0xffffffffu;

    bool isCore(std::uint32_t i) const { return mIsCore[i] != 0; }
    // The core point of the smallest number that is a neighbor of a border point, or has it as one.
    std::uint32_t coreNear(std::uint32_t border) const
    {
        return static_cast<const Number*>(mNearest.data())[border].load(std::memory_order_relaxed);
    }
    void offer(std::uint32_t border, std::uint32_t core)
    {
        Number& least = static_cast<Number*>(mNearest.data())[border];
        std::uint32_t known = least.load(std::memory_order_relaxed);
        while (core < known && !least.compare_exchange_weak(known, core, std::memory_order_relaxed)) {
        }
    }

private:
    using Number = std::atomic<std::uint32_t>;
    std::vector<std::uint8_t> mIsCore;
    PageBlock mNearest;
};

// Takes the pairs of a pass.
class ClusterPairs {
public:
    // Takes 4 bytes a particle of each of the two memories, which outlive it.
    ClusterPairs(std::size_t particles, std::optional<CorePoints> cores, bool isSymmetric,
                 PageArray<char> (&memory)[2])
        : mComponents(particles, memory[0]),
          mRankMemory(memory[1]),
          mCores(std::move(cores)),
          mIsSymmetric(isSymmetric)
    {
    }

    void add(std::uint32_t query, const std::uint32_t* neighbors, std::uint32_t count)
    {
        // Where every pair comes both ways, one is enough.
        const auto isFirst = [&](std::uint32_t j) { return !mIsSymmetric || j < query; };
        if (!mCores) {
            mComponents.unite(query, neighbors, count, isFirst);
        } else if (mCores->isCore(query)) {
            mComponents.unite(query, neighbors, count,
                              [&](std::uint32_t j) { return isFirst(j) && mCores->isCore(j); });
            for (std::uint32_t k = 0; k < count && !mIsSymmetric; ++k) {
                if (!mCores->isCore(neighbors[k])) mCores->offer(neighbors[k], query);
            }
        } else {
            for (std::uint32_t k = 0; k < count; ++k) {
                if (mCores->isCore(neighbors[k])) mCores->offer(query, neighbors[k]);
            }
        }
    }

    // Writes labels and sizes. `inCluster(i)`: whether a particle can be in one at all.
    template <typename InCluster>
    void finish(const MeasureTargets& targets, std::size_t particles, const CancelCheck& cancel,
                InCluster&& inCluster)
    {
        // The root of a cluster is the smallest number in it, of core points if there are any: roots in order have the ranks.
        const auto isRoot = [&](std::size_t i) {
            const auto number = static_cast<std::uint32_t>(i);
            return mComponents.isRoot(number) && (!mCores || mCores->isCore(number)) && inCluster(i);
        };
        const std::size_t chunks = (particles + kChunk - 1) / kChunk;
        std::vector<std::uint32_t> rootsBefore(chunks + 1);
        const auto forEachChunkOfRoots = [&](auto&& f) {
            tbb::parallel_for(std::size_t(0), chunks, [&](std::size_t chunk) {
                cancel.check();
                const std::size_t end = std::min(particles, (chunk + 1) * kChunk);
                for (std::size_t i = chunk * kChunk; i < end; ++i) {
                    if (isRoot(i)) f(chunk, i);
                }
            });
        };
        forEachChunkOfRoots([&](std::size_t chunk, std::size_t) { ++rootsBefore[chunk + 1]; });
        for (std::size_t chunk = 0; chunk < chunks; ++chunk) rootsBefore[chunk + 1] += rootsBefore[chunk];
        mRankMemory.resizeDiscarding(particles * sizeof(std::uint32_t));
        auto* const rank = reinterpret_cast<std::uint32_t*>(mRankMemory.data());
        std::vector<std::uint32_t> next(rootsBefore);
        forEachChunkOfRoots([&](std::size_t chunk, std::size_t i) { rank[i] = next[chunk]++; });

        std::vector<std::atomic<std::uint32_t>> size(rootsBefore.back());
        const auto labelOf = [&](std::size_t i) {
            auto with = static_cast<std::uint32_t>(i);
            if (mCores && !mCores->isCore(with)) with = mCores->coreNear(with);
            return inCluster(i) && with != CorePoints::kNone ? rank[mComponents.find(with)]
                                                             : CorePoints::kNone;
        };
        forEachChunk(particles, cancel, [&](std::size_t begin, std::size_t end) {
            // Counted run by run, for most points are in a few clusters.
            std::uint32_t last = CorePoints::kNone, run = 0;
            const auto add = [&] {
                if (last != CorePoints::kNone) size[last].fetch_add(run, std::memory_order_relaxed);
            };
            for (std::size_t i = begin; i < end; ++i) {
                const std::uint32_t label = labelOf(i);
                if (targets.cluster && label != CorePoints::kNone)
                    putInteger(targets.cluster, targets.areWide, i, label);
                if (label != last) add(), last = label, run = 0;
                ++run;
            }
            add();
        });
        if (!targets.clusterSize) return;
        forEachChunk(particles, cancel, [&](std::size_t begin, std::size_t end) {
            for (std::size_t i = begin; i < end; ++i) {
                const std::uint32_t label = labelOf(i);
                if (label != CorePoints::kNone)
                    putInteger(targets.clusterSize, targets.areWide, i,
                               size[label].load(std::memory_order_relaxed));
            }
        });
    }

private:
    Components mComponents;
    PageArray<char>& mRankMemory;
    std::optional<CorePoints> mCores;
    bool mIsSymmetric;
};

// --------------------------------------------------------------------------------------------------- passes

class PassCallback final : public RowCallback {
public:
    PassCallback(const SearchRun& run, RowBatch& batch, bool wantsRows, ClusterPairs* clusters,
                 std::uint32_t* rowCount)
        : mRun(run), mBatch(batch), mWantsRows(wantsRows), mClusters(clusters), mRowCount(rowCount), mMode()
    {
    }

    void take(std::uint32_t slot, const std::uint32_t* neighbors, std::uint32_t count) override
    {
        const std::uint32_t query = mRun.queries.number[slot];
        mRowCount[slot] = count;
        if (mWantsRows) mBatch.add(query, neighbors, count);
        if (mClusters) mClusters->add(query, neighbors, count);
    }

private:
    const SearchRun& mRun;
    RowBatch& mBatch;
    bool mWantsRows;
    ClusterPairs* mClusters;
    std::uint32_t* mRowCount;
    const IeeeMode mMode; // of the whole task
};

// One call of measure().
class MeasureJob {
public:
    MeasureJob(SearchEngine& engine, EngineState& state, const SearchSets& sets,
               const std::vector<std::string>& names, const MeasureOptions& options)
        : mEngine(engine),
          mState(state),
          mOptions(options),
          mSearch(searchOf(options)),
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
        beginPca();
        measured.counts = mTargets->wantsRows() || mTargets->wantsClusters() ? pass(measured.skipped)
                                                                             : mEngine.search(mSets, mSearch);
        if (mTargets->nearest) findNearest();
        writeCounts(measured.counts);
        measured.values = results.take();
        return measured;
    }

private:
    static SearchOptions searchOf(const MeasureOptions& options)
    {
        SearchOptions search = options.search;
        search.encoding = Encoding::kNone;
        search.includeSelf = false;
        search.radius = 0; // the sets are within it
        return search;
    }

    void checkMemory() const
    {
        const std::uint64_t each = MeasureResults::bytesEach(mMeasures, mOptions);
        std::uint64_t needed = mSets.bytes() + each * mSets.rowCount() +
                               PairPositions::bytesFor(mSets.queries(), mSets.candidates());
        for (const std::string& name : averagedNames()) {
            for (const PointAttribute& attribute : mOptions.attributes) {
                if (attribute.name == name)
                    needed += attribute.count * attributeWidth(attribute.type) * sizeof(double);
            }
        }
        const std::uint64_t allowed =
            mSearch.hostMemoryBytes ? mSearch.hostMemoryBytes : mSets.bytes() + availableMemoryBytes();
        if (needed > allowed)
            throw CapacityError("measures need " + std::to_string(needed) + " bytes of memory, allowed are " +
                                    std::to_string(allowed) +
                                    ": ask for fewer measures, or allow more host memory",
                                needed, allowed);
    }

    std::vector<std::string> averagedNames() const
    {
        std::vector<std::string> names;
        for (const Measure& measure : mMeasures) {
            if (measure.kind == MeasureKind::kAverage) names.push_back(measure.attribute);
        }
        return names;
    }

    // What points have that nobody is near: their position, and no rotation.
    void beginPca()
    {
        if (!mTargets->stretch) return;
        const ParticleView& view = mSets.queries();
        forEachChunk(view.size(), mCancel, [&](std::size_t begin, std::size_t end) {
            const IeeeMode mode;
            for (std::size_t i = begin; i < end; ++i) {
                const Vec3d world = view.worldPosition(i);
                std::copy(world.begin(), world.end(), mTargets->pws + 3 * i);
                for (std::size_t k = 0; k < 3; ++k) mTargets->xform[9 * i + 4 * k] = 1;
            }
        });
    }

    NeighborLists pass(std::vector<Measured::Skipped>& skipped)
    {
        const double start = wallSeconds();
        std::optional<ClusterPairs> clusters;
        if (mTargets->wantsClusters()) {
            std::optional<CorePoints> cores;
            if (mOptions.minNeighbors)
                cores.emplace(mEngine.search(mSets, mSearch), *mOptions.minNeighbors, mCancel);
            clusters.emplace(mSets.rowCount(), std::move(cores), mSets.data().radius.isOne(),
                             mState.clusters);
        }
        std::vector<std::unique_ptr<AveragedValues>> values;
        const std::vector<AveragedAttribute> averaged = readAveraged(values, skipped);
        PairPositions positions;
        if (mTargets->wantsRows())
            positions.read(mSets.queries(), mSets.candidates(), mSets.data().largestRadius, mCancel,
                           mState.positions);

        const SearchRuns runs(mSets, mSearch);
        const std::shared_ptr<NeighborListsData> result = mState.beginLists(mSets, Encoding::kNone, mSearch);
        mState.beginStatistics(mSearch);
        ChunkPool pool(std::move(result->chunks));
        mState.allowRows(runs, mSearch, 0, *result, pool);
        const double radius = mSets.data().radius.isOne() ? mSets.radius() : mSets.data().largestRadius;
        const RowMeasures measures{
            mSets.data(), kernelsFor(mSearch.simd).measure, positions, mOptions, *mTargets, averaged, radius};
        tbb::enumerable_thread_specific<RowBatch> batches([&] { return RowBatch(measures); });
        runs.forEach([&](const SearchRun& run) {
            visitTasks(mState, run, [&](const SearchRun& part, ThreadState&) {
                return PassCallback(part, batches.local(), mTargets->wantsRows(),
                                    clusters ? &*clusters : nullptr, result->rowCount.data() + part.firstRow);
            });
        });
        for (RowBatch& batch : batches) {
            const IeeeMode mode;
            batch.flush();
        }
        mState.finishLists(runs, pool, *result);
        mState.lists = result;
        if (clusters) {
            const NeighborListsData& lists = *result;
            clusters->finish(*mTargets, mSets.rowCount(), mCancel,
                             [&](std::size_t i) { return lists.slotOf[i] != kNoSlot || isFinite(i); });
        }
        mState.statistics.searchSeconds = wallSeconds() - start;
        return NeighborLists(result);
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
    const SearchSets mSets;
    const std::vector<Measure> mMeasures;
    const CancelCheck mCancel;
    const MeasureTargets* mTargets = nullptr;
};

} // namespace

Measured SearchEngine::measure(const SearchSets& sets, const std::vector<std::string>& measures,
                               const MeasureOptions& options)
{
    return isolated([&] { return MeasureJob(*this, *mImpl, sets, measures, options).run(); });
}

PointValues measure(const ParticleView& view, double radius, const std::vector<std::string>& measures,
                    const MeasureOptions& options)
{
    SearchEngine engine;
    return engine.measure(engine.buildGrid(view, radius, options.search), measures, options).values;
}

} // namespace vdb_nns

// A whole search: the grid, then lists in the encoding that is asked for or, where that does not fit and another will do, in
// that one. On devices each try is planned anew.
#include "vdb_nns/search_job.h"

#include "grid/search_sets_data.h"
#include "io/npz_search.h"
#include "job/host_budget.h"
#include "measure/measure_list.h"
#include "measure/measure_memory.h"
#include "search/engine_state.h"
#include "search/sample_rows.h"
#include "util/isolate.h"
#include "util/sole_owner.h"
#include "util/wall_clock.h"
#include "vdb_nns/memory.h"

#include <tbb/task_arena.h>

#include <algorithm>
#include <string>
#include <utility>

namespace vdb_nns {
namespace {

// Whether queries that are near each other in space mostly have numbers that are near too, as those of a .vdb do.
bool isNumberedAlongSpace(const SearchSets& sets)
{
    constexpr std::size_t kSamples = 1024;
    constexpr std::uint32_t kNear = 4096;
    const PageArray<std::uint32_t>& numbers = sets.data().parts.front().queries->number;
    if (numbers.size() < 2) return true;
    std::size_t near = 0;
    for (std::size_t k = 0; k < kSamples; ++k) {
        const std::size_t slot = (numbers.size() - 1) * k / kSamples;
        const std::uint32_t a = numbers[slot], b = numbers[slot + 1];
        near += std::max(a, b) - std::min(a, b) < kNear;
    }
    return 2 * near > kSamples;
}

// Where the cells are wider than the radius, masks are larger than they need be.
bool hasWideCells(const SearchSets& sets, const JobOptions& options)
{
    return options.search.cellSize == 0 && sets.cellSize() > 1.01 * sets.radius();
}

// Whether the lists are counts, and their rows are made again as they are written.
bool isStreamed(const JobOptions& options)
{
    return options.mayStream && options.search.encoding == Encoding::kNone;
}

// Takes less memory with the same output. Rows that go straight to an .npz are the fastest where their order is about that of
// the file; else masks, which take a quarter of the memory or less, in cells of the radius where wider ones are too much. Says
// what is done instead; empty: nothing is left.
std::string takeLess(const SearchSets& sets, JobOptions& options)
{
    const Encoding encoding = options.search.encoding;
    if (encoding == Encoding::kMask && hasWideCells(sets, options)) {
        options.search.cellSize = 1;
        return "the grid is made again in cells of the radius";
    }
    const bool mayStream = options.mayStream && encoding != Encoding::kNone;
    const bool mayUseMasks = options.mayUseMasks && options.search.nearest == 0;
    if (mayUseMasks && encoding == Encoding::kIndex && !(mayStream && isNumberedAlongSpace(sets))) {
        options.search.encoding = Encoding::kMask;
        if (hasWideCells(sets, options)) options.search.cellSize = 1;
        return "lists are held as masks instead";
    }
    if (!mayStream) return {};
    options.search.encoding = Encoding::kNone;
    return "no lists are held, and rows go straight to the file instead";
}

// The engine, the job and what it has come to so far.
class Job {
public:
    Job(SearchEngine& engine, EngineState& state, const JobOptions& options, JobReport& report)
        : mEngine(engine),
          mState(state),
          mBudget(options.search.hostMemoryBytes, tbb::this_task_arena::max_concurrency(), options.written,
                  MeasureMemory(measuresOf(options.measures), options.measure)),
          mReport(report)
    {
        JobOptions settled = options; // which may be those of the report
        mReport = JobReport();
        mReport.settled = std::move(settled);
        // Masks are sent over the link.
        mReport.settled.search.wideCells &= mReport.settled.device.devices.empty();
        mReport.settled.device.estimate.radius = mReport.settled.search.radius;
    }

    NeighborLists run(const ParticleSet& candidates, const ParticleSet& queries, const Radius& radius)
    {
        return mBudget.explained([&] {
            const auto makeSets = [&] { return sort(candidates, queries, radius); };
            SearchSets sets = makeSets();
            const double start = wallSeconds(), gridSeconds = mReport.gridSeconds;
            mBudget.beginLists(sets, reusableBytes());
            const NeighborLists lists = searchAndWrite(std::move(sets), makeSets);
            measureApart(lists);
            const double otherSeconds =
                mPlanningSeconds + mReport.gridSeconds - gridSeconds + mReport.measureSeconds.value_or(0);
            mReport.searchSeconds = wallSeconds() - start - otherSeconds - mReport.writeSeconds;
            mReport.streamed = mReport.written || isStreamed(mReport.settled);
            mReport.streamBufferBytes = mBudget.bufferBytes(lists.sets());
            return lists;
        });
    }

    JobPlan plan(const ParticleSet& candidates, const ParticleSet& queries, const Radius& radius)
    {
        JobPlan result;
        result.sets = mBudget.explained([&] { return sort(candidates, queries, radius); });
        result.gridSeconds = mReport.gridSeconds;
        result.measureBytes = mBudget.attributeBytes(result.sets);
        const SearchOptions& search = mReport.settled.search;
        if (!isPlain(result.sets, search)) {
            result.plan = planSets(result.sets, search);
            return result;
        }
        result.grid = gridOf(result.sets);
        result.plan = makePlan(result.grid, mReport.settled.device, search.encoding, PlanDetail::kFull,
                               search.progress);
        return result;
    }

private:
    SearchSets sort(const ParticleSet& candidates, const ParticleSet& queries, const Radius& radius)
    {
        const double start = wallSeconds();
        if (mBudget.isBounded()) forget(); // the grid's sort needs the room of the last lists
        mBudget.begin();
        SearchOptions options = mReport.settled.search;
        options.hostMemoryBytes = mBudget.gridBytes();
        SearchSets sets = mEngine.sort(candidates, queries, radius, options);
        if (mBudget.isBounded()) returnFreedMemory();
        mReport.gridSeconds += wallSeconds() - start;
        return sets;
    }

    // Counts of rows that went to the file at once, or lists.
    template <typename MakeSets>
    NeighborLists searchAndWrite(SearchSets sets, const MakeSets& makeSets)
    {
        const JobOptions& options = mReport.settled;
        const bool isWanted = options.npz && options.search.encoding == Encoding::kIndex;
        if (isWanted && options.device.devices.empty()) {
            const NpzTarget& target = *options.npz;
            const NpzSearchOptions npz{target.path, target.form, target.output, target.checksum,
                                       mBudget.windowBytes(sets)};
            if (std::optional<NpzSearchResult> result = searchToNpz(mState, sets, options.search, npz)) {
                mReport.written = true;
                mReport.writeSeconds = result->writeSeconds;
                if (target.checksum) mReport.checksum = result->checksum;
                return result->lists;
            }
        }
        return search(std::move(sets), makeSets);
    }

    // Of lists that are there, or null.
    Measured measure(const SearchSets& sets, const NeighborLists* lists)
    {
        MeasureOptions options = mReport.settled.measure;
        options.search = mReport.settled.search;
        options.search.radius = 0; // the sets are within it
        options.search.hostMemoryBytes = mBudget.measureBytes(sets, lists ? lists->bytes() : 0);
        const std::vector<std::string>& names = mReport.settled.measures;
        const bool canReadLists =
            lists && lists->encoding() != Encoding::kNone && !options.search.includeSelf;
        Measured measured =
            canReadLists ? mEngine.measure(*lists, names, options) : mEngine.measure(sets, names, options);
        mReport.measured = std::move(measured.values);
        mReport.measureSkipped = std::move(measured.skipped);
        mHasMeasured = true;
        return measured;
    }

    // From the lists if they are held, or in a pass of its own, if the one that counted did not make the measures.
    void measureApart(const NeighborLists& lists)
    {
        if (mHasMeasured || mReport.settled.measures.empty()) return;
        const double start = wallSeconds();
        measure(lists.sets(), &lists);
        mReport.measureSeconds = wallSeconds() - start;
    }

    // Lists in the first encoding that fits.
    template <typename MakeSets>
    NeighborLists search(SearchSets sets, const MakeSets& makeSets)
    {
        JobOptions& options = mReport.settled;
        for (;;) {
            try {
                SearchOptions search = options.search;
                search.hostMemoryBytes = mBudget.listBytes(sets, search.encoding);
                const bool isCounted = search.encoding == Encoding::kNone && options.device.devices.empty();
                if (isCounted && !options.measures.empty()) return measure(sets, nullptr).counts;
                if (options.device.devices.empty()) return mEngine.search(sets, search);
                return searchOnDevices(gridOf(sets), search);
            } catch (const CapacityError& error) {
                const double cellSize = options.search.cellSize;
                const std::string instead = takeLess(sets, options);
                if (instead.empty()) throw;
                mReport.notes.push_back(error.what() + ("; " + instead));
                if (options.search.cellSize != cellSize) sets = narrow(std::move(sets), makeSets);
            }
        }
    }

    NeighborLists searchOnDevices(const SparseGrid& grid, const SearchOptions& search)
    {
        const DeviceOptions& device = mReport.settled.device;
        mReport.plan = makePlan(grid, device, search.encoding, PlanDetail::kAsNeeded, search.progress);
        mPlanningSeconds += mReport.plan->estimateSeconds + mReport.plan->planSeconds;
        RunOptions run;
        run.search = search;
        run.schedule = device.schedule;
        run.onFailure = device.onFailure;
        mReport.run.emplace();
        return mEngine.search(grid, mReport.plan->schedule, mReport.plan->devices, run, *mReport.run);
    }

    static bool isPlain(const SearchSets& sets, const SearchOptions& search)
    {
        const SearchSetsData& data = sets.data();
        return data.parts.size() == 1 && isPlainSearch(data, data.parts[0], search);
    }

    static InvalidInput notForDevices()
    {
        return InvalidInput("devices search all particles within one radius: search other queries, groups, "
                            "radii of particles and the nearest without devices");
    }

    // What devices search: all particles of one grid within one radius.
    static SparseGrid gridOf(const SearchSets& sets)
    {
        const SearchSetsData& data = sets.data();
        if (data.parts.size() != 1 || data.parts[0].queries != data.parts[0].own.candidates ||
            !data.radius.isOne())
            throw notForDevices();
        return SparseGrid(data.parts[0].queries);
    }

    // Radii of particles, as the caller has them.
    static std::uint64_t radiusBytes(const SearchSets& sets)
    {
        const Radius& radius = sets.data().radius;
        const bool areShared = radius.ofQueries.data() == radius.ofCandidates.data();
        return (radius.ofQueries.size() + (areShared ? 0 : radius.ofCandidates.size())) * sizeof(double);
    }

    // On the CPU, which takes them as a whole.
    Plan planSets(const SearchSets& sets, const SearchOptions& search)
    {
        constexpr std::size_t kSampledQueries = 1024; // of each part
        const DeviceOptions& device = mReport.settled.device;
        if (!device.devices.empty()) throw notForDevices();
        Plan plan;
        const double start = wallSeconds();
        mState.beginStatistics(search);
        const SearchRuns runs(setsWithin(sets, search.radius), search);
        runs.forEach([&](const SearchRun& run) {
            const RowSample sample = sampleRows(run, kSampledQueries, mState.states.local());
            plan.countedQueries += sample.queries;
            plan.total.expectedPairs +=
                sample.entriesEach() * static_cast<double>(run.queries.particleCount());
        });
        plan.estimator = Estimator::kSampled;
        plan.total.particles = sets.finiteQueries();
        const ListWork work = isolatedIeee([&] { return countListWork(runs, search.progress, "estimate"); });
        plan.total.candidateTests = work.candidateTests;
        plan.total.maskBytes = work.maskBytes;
        plan.everything.up = sets.bytes() + radiusBytes(sets);
        if (search.encoding == Encoding::kMask) plan.everything.down = work.maskBytes;
        if (search.encoding == Encoding::kIndex) {
            plan.everything.down =
                static_cast<std::uint64_t>(plan.total.expectedPairs * sizeof(std::uint32_t));
        }
        plan.everything.down +=
            runs.rowCount() * 2 * sizeof(std::uint64_t); // slot, count and place of each row
        plan.schedule.model.encoding = search.encoding;
        plan.schedule.cpuParticles = plan.total.particles;
        plan.schedule.predictedSeconds = plan.schedule.lowerBoundSeconds = plan.schedule.cpuBusySeconds =
            static_cast<double>(work.candidateTests) / device.schedule.cpuTestsPerSecond;
        plan.estimateSeconds = wallSeconds() - start;
        return plan;
    }

    // The sets once more, in the cells of the options.
    template <typename MakeSets>
    SearchSets narrow(SearchSets sets, const MakeSets& makeSets)
    {
        sets = SearchSets();
        forget(); // memory was short
        SearchSets again = makeSets();
        mBudget.beginLists(again, 0);
        return again;
    }

    void forget() { mState = EngineState(); }

    // What the engine holds of the last job and hands to this one's lists.
    std::uint64_t reusableBytes() const
    {
        std::uint64_t bytes = 0;
        for (const OpenedDevice& device : mState.devices) bytes += device.hostBytes;
        if (!mState.lists || !isSoleOwner(mState.lists)) return bytes;
        const NeighborListsData& lists = *mState.lists;
        for (const PageBlock& chunk : lists.chunks) bytes += chunk.bytes();
        return bytes + lists.slotOf.usedBytes() + lists.rowCount.usedBytes() + lists.rowBegin.usedBytes();
    }

    SearchEngine& mEngine;
    EngineState& mState;
    HostBudget mBudget;
    JobReport& mReport;
    double mPlanningSeconds = 0; // of all tries
    bool mHasMeasured = false;
};

} // namespace

NeighborLists SearchEngine::findNeighbors(const ParticleView& view, double radius, const JobOptions& options,
                                          JobReport& report)
{
    return findNeighbors(view, view, radius, options, report);
}

NeighborLists SearchEngine::findNeighbors(const ParticleSet& candidates, const ParticleSet& queries,
                                          const Radius& radius, const JobOptions& options, JobReport& report)
{
    return Job(*this, *mImpl, options, report).run(candidates, queries, radius);
}

JobPlan SearchEngine::planJob(const ParticleView& view, double radius, const JobOptions& options)
{
    return planJob(view, view, radius, options);
}

JobPlan SearchEngine::planJob(const ParticleSet& candidates, const ParticleSet& queries, const Radius& radius,
                              const JobOptions& options)
{
    JobReport report;
    return Job(*this, *mImpl, options, report).plan(candidates, queries, radius);
}

NeighborLists findNeighbors(const ParticleView& view, double radius, const JobOptions& options,
                            JobReport& report)
{
    return SearchEngine().findNeighbors(view, radius, options, report);
}

void writeJobNpz(const std::string& path, SearchEngine& engine, const NeighborLists& lists,
                 const JobReport& report, const ListForm& form, const OutputOptions& output)
{
    const SearchOptions& search = report.settled.search;
    if (search.hostMemoryBytes > 0) returnFreedMemory(); // of outputs that were written before
    if (report.streamed) {
        streamNpz(path, engine, lists, form, output, report.streamBufferBytes, search);
    } else {
        writeNpz(path, lists, form, output, search.progress);
    }
}

} // namespace vdb_nns

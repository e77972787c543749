#include "search_run.h"

#include "machine.h"
#include "numbers.h"
#include "point_input.h"
#include "search_progress.h"
#include "standard_streams.h"
#include "vdb_nns/error.h"
#include "vdb_nns/tiles.h"
#include "vdb_nns/write_points.h"

#include <tbb/combinable.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

namespace vdb_nns::cli {
namespace {

// Shares of a run, roughly, for progress alone.
constexpr double kReadShare = 0.2, kFindShare = 0.6, kWriteShare = 0.2;

// Voxels of a new .vdb are as large as the radius, or the largest, if they are not said to be otherwise. A radius that served all
// points is what the file suggests.
NewGridOptions newGridOptions(const SearchPlan& plan, const QueryInput& input, double radius)
{
    NewGridOptions grid;
    if (!plan.query.hasRadii) grid.suggestedRadius = radius;
    grid.voxelSize = plan.voxelSize.value_or(input.largestRadius(radius));
    return grid;
}

// The result attributes by name and type alone.
PointValues namesOf(const MeasurePlan& plan, const MeasureOptions& options)
{
    PointValues values;
    const MeasuredNames names = checkMeasures(plan.names, options); // which knows the types of averages now
    for (const MeasuredNames::Value& value : names.attributes)
        values.attributes.push_back({value.name, value.type, 0, nullptr});
    for (const std::string& group : names.groups) values.groups.push_back({group, 0, nullptr});
    return values;
}

// The checksum of NeighborLists::checksum() without stored lists.
std::uint64_t visitChecksum(SearchEngine& engine, const SearchSets& sets, const SearchOptions& options)
{
    tbb::combinable<std::uint64_t> sums([] { return std::uint64_t{0}; });
    engine.visitRows(
        sets,
        [&](std::uint32_t query, Span<const std::uint32_t> neighbors) {
            std::uint64_t sum = 0;
            for (const std::uint32_t neighbor : neighbors)
                sum += mix64((std::uint64_t{query} << 32) + neighbor);
            sums.local() += sum;
        },
        options);
    return sums.combine([](std::uint64_t a, std::uint64_t b) { return a + b; });
}

const PointFile& rowsOf(const QueryInput& input)
{
    return input.queries ? *input.queries : input.candidates;
}

} // namespace

SearchRun::SearchRun(const SearchFlags& flags, SearchPlan plan, int threads, Session& session)
    : mFlags(flags), mPlan(std::move(plan)), mSession(session), mOptions(mPlan.job)
{
    mReport.device.threads = threads;
    mOptions.measure = mPlan.measure.options;
}

SearchRun::~SearchRun() = default;

void SearchRun::read(ProgressPrinter& progress)
{
    const CommonFlags& common = mFlags.common;
    PointNeeds needs{!common.json.empty(), mFlags.nonfinite == "fail", common.quiet,
                     mOptions.search.hostMemoryBytes, mPlan.query.hasRadii};
    if (mPlan.readsTileAlone) needs.tile = TileOfFile{mPlan.tile->tile, mPlan.tile->tiles};
    needs.tellsRadius = mFlags.frames.empty(); // the line of a frame has it
    mInput = readQuerySets(mFlags.input, mFlags.query, mPlan.query, needs, {progress, 0, kReadShare},
                           mSession, mReport);
    if (mPlan.tile) chooseTile(progress);
    if (!mOptions.measures.empty()) {
        mMeasured = readMeasureInput(mInput.candidates, mPlan.measure, &progress);
        mOptions.measure = optionsOf(mPlan.measure, mMeasured);
    }
    mGrid = newGridOptions(mPlan, mInput, mReport.radius);
    if (mPlan.writesAttributes()) {
        const PointFile& rows = rowsOf(mInput);
        const PointValues names = namesOf(mPlan.measure, mOptions.measure);
        checkAttributeOutputs(mPlan.attributes, rows, names, mGrid, common.force, &progress);
        mKept = readKept(mPlan.attributes, rows, mFlags.keep, names, common.force, &progress);
        mOptions.written.keptBytes = mKept.bytesEach();
        if (!common.quiet) warnOfLeftOut(mKept.leftOut);
    }
    checkReadingPeak(mOptions.search.hostMemoryBytes, "the points and the values that come along",
                     ", or leave values out with --keep none");
}

// Its rows are the queries, as far as they are any.
void SearchRun::chooseTile(ProgressPrinter& progress)
{
    const ParticleView& rows = rowsOf(mInput).view();
    if (const TileNumbers* tile = mInput.candidates.tileNumbers()) {
        mTileRows.resize(tile->end - tile->begin);
        std::iota(mTileRows.begin(), mTileRows.end(), static_cast<std::uint32_t>(tile->begin));
    } else {
        const TileCut cut(rows, mInput.largestRadius(mReport.radius), mPlan.tile->tiles, &progress);
        mTileRows = cut.particles(mPlan.tile->tile - 1);
    }
    std::vector<std::uint8_t> chosen(rows.size());
    for (const std::uint32_t row : mTileRows) {
        chosen[row] = mInput.queryChosen.empty() || mInput.queryChosen[row] != 0;
    }
    mInput.queryChosen = std::move(chosen);
    mReport.tile = TileReport{mPlan.tile->tile, mPlan.tile->tiles, mTileRows.size()};
}

// All that makes the lists what they are, but for the bytes of the files.
std::string SearchRun::optionsText() const
{
    const QueryPlan& query = mPlan.query;
    const QueryFlags& flags = mFlags.query;
    const PointFile& candidates = mInput.candidates;
    const ListForm form = listForm(mFlags, mPlan);
    std::string text = shortest(mInput.largestRadius(mReport.radius)) + " " + shortest(query.radiusScale);
    for (const std::uint64_t number :
         {static_cast<std::uint64_t>(query.mode), static_cast<std::uint64_t>(query.hasRadii),
          static_cast<std::uint64_t>(query.nearest), static_cast<std::uint64_t>(query.includeSelf),
          static_cast<std::uint64_t>(form.values), static_cast<std::uint64_t>(form.order)})
        text += " " + std::to_string(number);
    std::vector<std::string> names = {candidates.grid(), candidates.taken(), flags.queryGroup,
                                      flags.candidateGroup, flags.radiusAttribute};
    if (mInput.queries) names.insert(names.end(), {mInput.queries->grid(), mInput.queries->taken()});
    for (const std::string& name : names) text += " " + std::to_string(name.size()) + ":" + name;
    return text;
}

void SearchRun::writePart(const std::string& path, ProgressPrinter& progress)
{
    PartOrigin origin;
    origin.tile = mPlan.tile->tile;
    origin.tiles = mPlan.tile->tiles;
    const TileNumbers* const numbers = mInput.candidates.tileNumbers();
    origin.rows = numbers ? numbers->total : mLists.size();
    std::vector<std::string> files = queryFiles(mFlags.query);
    files.push_back(mFlags.input.path);
    for (const std::string& file : files) origin.input = mix64(origin.input) ^ hashFile(file, &progress);
    const std::string options = optionsText();
    for (const char c : options) origin.options = mix64(origin.options ^ static_cast<unsigned char>(c));
    writeNpzPart(path, mLists, mTileRows, origin, listForm(mFlags, mPlan), outputOptions(mFlags.common),
                 &progress, numbers);
}

// The job, as often as is asked for with buffers kept; the last lists stay.
void SearchRun::runJobs(ProgressPrinter& progress)
{
    std::vector<double> gridSeconds, searchSeconds;
    JobOptions options = mOptions;
    for (std::uint64_t run = 0; run < mPlan.repeat; ++run) {
        mLists = NeighborLists(); // frees what the engine may use again
        const double step = kFindShare / static_cast<double>(mPlan.repeat);
        SearchProgress steps({progress, kReadShare + step * static_cast<double>(run),
                              kReadShare + step * static_cast<double>(run + 1)});
        options.search.progress = &steps;
        const auto tell = [&] {
            for (const std::string& note : mJob.notes) {
                if (!mFlags.common.quiet) say(note);
            }
        };
        try {
            mLists = mEngine->findNeighbors(mInput.candidateSet(), mInput.querySet(),
                                            mInput.radius(mReport.radius), options, mJob);
        } catch (const CapacityError&) {
            tell();
            throw;
        }
        tell();
        options = mJob.settled;
        gridSeconds.push_back(mJob.gridSeconds);
        searchSeconds.push_back(mJob.searchSeconds);
    }
    mJob.settled.search.progress = nullptr; // that of the steps is gone
    SecondsReport& seconds = mReport.seconds;
    seconds.firstGrid = gridSeconds.front();
    seconds.firstSearch = searchSeconds.front();
    seconds.grid = median(std::move(gridSeconds));
    seconds.search = median(std::move(searchSeconds));
    seconds.measure = mJob.measureSeconds;
    if (mJob.plan) {
        seconds.estimate = mJob.plan->estimateSeconds;
        seconds.plan = mJob.plan->planSeconds;
    }
}

void SearchRun::fillReport()
{
    if (mPlan.query.hasRadii) mReport.radius = mLists.sets().radius();
    fillGridReport(mLists.sets(), mJob.settled.search, mReport);
    if (const TileNumbers* tile = mInput.candidates.tileNumbers())
        mReport.points = mReport.rows = tile->total;
    mReport.listBytes = mLists.bytes();
    mReport.encoding = mJob.streamed ? Encoding::kIndex : mLists.encoding();
    mReport.straightToFile = mJob.streamed;
    if (!mFlags.common.json.empty()) mReport.candidateTests = countCandidateTests(mLists.sets());
    const SearchStatistics& statistics = mEngine->statistics();
    mReport.doublePairs = statistics.doublePairs;
    mReport.exactPairs = statistics.exactPairs;
    mReport.simd = simdLevelName(statistics.simd);
    mReport.result = mLists.statistics();
    mReport.plan = mJob.plan;
    mReport.run = mJob.run;
}

void SearchRun::find(SearchEngine& engine, ProgressPrinter& progress)
{
    mEngine = &engine;
    runJobs(progress);
    fillReport();
}

void SearchRun::makeChecksum()
{
    const bool stored = mLists.encoding() != Encoding::kNone, wanted = stored || mJob.streamed;
    mReport.checksum = mJob.checksum;
    if (mJob.checksum || (!mFlags.checksum && (mFlags.common.json.empty() || !wanted))) return;
    const Stopwatch watch;
    const SearchOptions& search = mJob.settled.search;
    mReport.checksum =
        stored ? mLists.checksum(search.progress) : visitChecksum(*mEngine, mLists.sets(), search);
    mReport.seconds.checksum = watch.seconds();
}

// The result attributes.
PointValues SearchRun::values()
{
    if (!mOptions.measures.empty()) return mJob.measured;
    mCounts = mLists.counts();
    PointValues values;
    values.attributes.push_back(viewAttribute(mPlan.measure.results.attributes.at(0).name,
                                              AttributeType::kInt32, mCounts.data(), mCounts.size()));
    return values;
}

void SearchRun::reportValues(const PointValues& values)
{
    WrittenMeasures& written = mReport.measures.emplace();
    for (const PointAttribute& attribute : values.attributes)
        written.attributes.push_back({attribute.name, attributeTypeName(attribute.type)});
    for (const PointGroup& group : values.groups) written.groups.push_back(group.name);
    written.skipped = mJob.measureSkipped;
    written.kept = mKept.kept();
    written.leftOut = mKept.leftOut;
}

void SearchRun::writeOutputs(ProgressPrinter& progress)
{
    std::vector<std::string> paths = mFlags.outputs;
    if (!mPlan.attributes.arrays.empty()) paths.push_back(mPlan.attributes.arrays);
    if (paths.empty()) return;
    const Stopwatch watch;
    const OutputOptions output = outputOptions(mFlags.common);
    PointValues made;
    if (mPlan.writesAttributes()) {
        made = values();
        reportValues(made);
    }
    const double share = kWriteShare / static_cast<double>(paths.size());
    for (std::size_t i = 0; i < paths.size(); ++i) {
        const std::string& path = paths[i];
        const double from = kReadShare + kFindShare + share * static_cast<double>(i);
        progress.begin("write", from, from + share);
        if (i == mFlags.outputs.size()) {
            writeArraysNpz(path, made, output, &progress);
        } else if (extensionOf(path) == ".npz") {
            if (mPlan.tile) {
                writePart(path, progress);
            } else if (!mJob.written) {
                writeJobNpz(path, *mEngine, mLists, mJob, listForm(mFlags, mPlan), output);
            }
        } else if (const auto written = writePoints(path, rowsOf(mInput), mKept.before(path, made), mGrid,
                                                    output, &progress)) {
            mReport.measures->voxelSize = written->voxelSize;
            mReport.measures->largestRounding = written->largestRounding;
            for (const std::string& warning : warningsOf(path, *written)) {
                if (!mFlags.common.quiet) say("warning: " + warning);
            }
        }
        mReport.written.push_back(path);
    }
    mReport.seconds.write = mJob.writeSeconds + watch.seconds();
}

void SearchRun::write(ProgressPrinter& progress)
{
    mJob.settled.search.progress = &progress;
    makeChecksum();
    writeOutputs(progress);
    throwIfStopped();
    mReport.peakBytes = peakMemoryBytes();
    mReport.seconds.total = mTotal.seconds();
}

} // namespace vdb_nns::cli

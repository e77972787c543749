#include "bench/studies/set_study.h"

#include "bench/method_names.h"
#include "bench/methods/other_methods.h"
#include "bench/methods/set_methods.h"
#include "bench/run_order.h"
#include "bench/studies/radii_points.h"
#include "machine.h"
#include "numbers.h"
#include "vdb_nns/error.h"
#include "vdb_nns/search.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <iterator>
#include <limits>
#include <memory>
#include <new>
#include <optional>
#include <utility>

namespace vdb_nns::cli {
namespace {

// A method and what it is asked for.
struct Contender {
    std::string name;
    std::unique_ptr<Method> method;
    SetSearch search;
    bool isOurs = false;
    std::vector<std::uint8_t> timed = {}; // queries; empty: all
    std::uint64_t queries = 0;

    std::vector<double> grid = {}, searching = {}, total = {};
    SetResult result = {};
};

template <typename T>
Span<const T> spanOf(const std::vector<T>& values)
{
    return {values.data(), values.size()};
}

// The engine's candidate tests in a search of one radius or of many; 0 where it refuses, as it will when it
// is timed.
double testsOf(const SetSearch& search, const SearchOptions& options)
{
    try {
        return static_cast<double>(countCandidateTests(
            SearchEngine().sort(search.candidates, search.queries, search.radius, options)));
    } catch (const CapacityError&) {
        return 0;
    }
}

// Of a candidate that is a hit, in tests: its distance is computed in double and handed over, 7 ns against a
// quarter of one.
constexpr double kTestsPerHit = 40;

// Chooses queries, by number, so many that the engine makes no more than `most` tests.
void timeSome(const SetSearch& engineSearch, double most, const SetStudyOptions& options,
              Contender& contender)
{
    const double share = most / std::max(1.0, testsOf(engineSearch, options.search));
    if (share >= 1) return;
    contender.queries = 0;
    contender.timed.resize(engineSearch.queries.view.size());
    const std::uint64_t start = mix64(options.seed ^ 0x5e75ull); // other draws than those of the radii
    for (std::size_t i = 0; i < contender.timed.size(); ++i) {
        contender.timed[i] = static_cast<double>(mix64(start + i) >> 11) * 0x1p-53 < share;
        contender.queries += contender.timed[i];
    }
    if (contender.queries == 0) contender.queries = contender.timed.front() = 1;
    contender.search.queries.chosen = spanOf(contender.timed);
}

class SetStudy {
public:
    SetStudy(const std::string& scene, const std::string& radii, const SetSearch& asked,
             const SetStudyOptions& options, const ProgressSpan& span)
        : mAsked(asked), mOptions(options), mSpan(span)
    {
        mResult.scene = scene;
        mResult.radii = radii;
        mResult.nearest = asked.nearest;
        mResult.points = asked.queries.view.size();
        span.printer.begin("truth", span.begin, span.begin + 0.3 * (span.end - span.begin));
        mTruth = findTruth(asked, options.truth);
        mResult.isComplete = mTruth.complete;
        if (asked.radius.isOne()) return;
        mResult.mode = asked.radius.mode == RadiusMode::kGather    ? "gather"
                       : asked.radius.mode == RadiusMode::kScatter ? "scatter"
                                                                   : "symmetric";
    }

    const Truth& truth() const { return mTruth; }

    Contender& add(const std::string& name, std::unique_ptr<Method> method, const SetSearch& search)
    {
        Contender contender{name, std::move(method), search};
        contender.queries = mResult.points;
        mContenders.push_back(std::move(contender));
        return mContenders.back();
    }

    std::unique_ptr<Method> engine() const
    {
        return makeMethod(parseMethod("ours-index"), {mOptions.search, {}, 1});
    }

    void addOurs()
    {
        Contender& ours = add("ours", engine(), mAsked);
        ours.isOurs = true;
        timeSome(mAsked, mOptions.mostTests, mOptions, ours);
    }

    // The largest radius for all, or all neighbors.
    void addFiltered(const std::string& name)
    {
        SetSearch wide = mAsked;
        wide.radius = mAsked.largestRadius();
        timeSome(wide, mOptions.mostTests / kTestsPerHit, mOptions,
                 add(name, makeFilteredMethod(mOptions.search), mAsked));
    }

    // Where it was built in.
    void addPeer(const std::string& name, const std::string& family, const SetSearch& search)
    {
        if (!missingPeer(family).empty()) return;
        const MethodSpec spec = parseMethod(family);
        if (missingSearch(spec, search).empty()) add(name, makePeerMethod(spec), search);
    }

    // K nearest whatever their distance.
    void addNearestAlone(const std::string& name, std::uint32_t nearest)
    {
        SetSearch search = mAsked;
        search.radius = std::numeric_limits<double>::infinity();
        search.nearest = nearest;
        addPeer(name, "nanoflann-double", search);
    }

    std::vector<SetResult> run()
    {
        const std::size_t count = mContenders.size();
        const double from = mSpan.begin + 0.3 * (mSpan.end - mSpan.begin);
        const ProgressSpan span{mSpan.printer, from, mSpan.end};
        std::size_t step = 0;
        for (std::uint64_t run = 0; run <= mOptions.repeat; ++run) {
            for (const std::size_t k : orderOfRun(count, run))
                runOnce(mContenders[k], run, span.part(step++, count * (mOptions.repeat + 1)));
        }
        std::vector<SetResult> results;
        for (Contender& contender : mContenders) results.push_back(summarize(contender));
        const double ours = results.front().totalSeconds;
        for (SetResult& result : results) result.ratio = ours > 0 ? result.totalSeconds / ours : 0;
        return results;
    }

private:
    // Run 0 warms up and is not counted; what the last one found is compared at once and let go.
    void runOnce(Contender& contender, std::uint64_t run, const ProgressSpan& span)
    {
        if (!contender.result.message.empty()) return;
        try {
            const MethodRun done = contender.method->runSets(contender.search, span);
            if (run > 0) {
                const double scale =
                    static_cast<double>(mResult.points) / static_cast<double>(contender.queries);
                contender.grid.push_back(done.gridSeconds);
                contender.searching.push_back(scale * done.searchSeconds);
                contender.total.push_back(done.gridSeconds + scale * done.searchSeconds);
            }
            if (run == mOptions.repeat) {
                contender.result.pairs = done.pairs;
                contender.result.wrong =
                    findWrongPairs(contender.method->found(), mTruth, spanOf(contender.timed));
            }
            contender.method->discard();
        } catch (const Cancelled&) {
            throw;
        } catch (const std::bad_alloc&) {
            refuse("asked for more memory than there is", contender);
        } catch (const std::exception& error) { // also what a peer throws
            refuse(error.what(), contender);
        }
    }

    static void refuse(const std::string& message, Contender& contender)
    {
        contender.result.message = message;
        contender.result.refusal = std::current_exception();
        contender.method->discard();
    }

    SetResult summarize(const Contender& contender) const
    {
        SetResult result = mResult;
        result.method = contender.name;
        result.isOurs = contender.isOurs;
        result.queries = contender.queries;
        result.message = contender.result.message;
        result.refusal = contender.result.refusal;
        if (!result.message.empty()) return result;
        result.pairs = contender.result.pairs;
        result.wrong = contender.result.wrong;
        for (std::size_t k = 0; k < mTruth.queries.size(); ++k) {
            if (contender.timed.empty() || contender.timed[mTruth.queries[k]] != 0)
                result.truePairs += mTruth.row(k).size();
        }
        result.runs = contender.total.size();
        result.gridSeconds = median(contender.grid);
        result.searchSeconds = median(contender.searching);
        result.totalSeconds = median(contender.total);
        result.minSeconds = *std::min_element(contender.total.begin(), contender.total.end());
        result.maxSeconds = *std::max_element(contender.total.begin(), contender.total.end());
        return result;
    }

    const SetSearch mAsked;
    const SetStudyOptions& mOptions;
    const ProgressSpan mSpan;
    SetResult mResult; // what all have in common
    Truth mTruth;
    std::vector<Contender> mContenders;
};

std::uint32_t meanLength(const Truth& truth)
{
    const double queries = static_cast<double>(std::max<std::size_t>(1, truth.queries.size()));
    return static_cast<std::uint32_t>(
        std::max(1.0, std::round(static_cast<double>(truth.pairs()) / queries)));
}

void append(std::vector<SetResult> more, std::vector<SetResult>& results)
{
    std::move(more.begin(), more.end(), std::back_inserter(results));
}

std::vector<SetResult> studyModes(const std::string& scene, const RadiiPoints& points,
                                  const SetStudyOptions& options, const ProgressSpan& span)
{
    constexpr RadiusMode kModes[] = {RadiusMode::kGather, RadiusMode::kScatter, RadiusMode::kSymmetric};
    // The largest radius over the smallest: TreeNSearch's cells are of the largest, and beyond this they hold
    // too much.
    constexpr double kMostTreeNSearch = 8;
    const auto [least, most] = std::minmax_element(points.radii.begin(), points.radii.end());
    const double radiiSpan = *most / *least;
    std::vector<SetResult> results;
    for (std::size_t m = 0; m < std::size(kModes); ++m) {
        SetSearch search(points.view, 0);
        search.radius.mode = kModes[m];
        if (kModes[m] != RadiusMode::kScatter) search.radius.ofQueries = spanOf(points.radii);
        if (kModes[m] != RadiusMode::kGather) search.radius.ofCandidates = spanOf(points.radii);
        SetStudy study(scene, points.name, search, options, span.part(m, std::size(kModes)));
        study.addOurs();
        study.addFiltered("largest-filtered");
        study.add("octaves", makeOctaveMethod(options.search), search);
        study.addPeer("nanoflann", "nanoflann-double", search);
        study.addNearestAlone("nanoflann-k", meanLength(study.truth()));
        if (radiiSpan <= kMostTreeNSearch) study.addPeer("treensearch", "treensearch", search);
        append(study.run(), results);
    }
    return results;
}

} // namespace

std::vector<SetResult> studyRadii(const BenchPoints& points, const SetStudyOptions& options,
                                  const ProgressSpan& span)
{
    std::vector<SetResult> results;
    if (points.view.size() == 0) return results;
    append(studyModes(points.scene, gradedPoints(points.view.size(), options.radius, options.seed), options,
                      span.part(0, 2)),
           results);
    append(
        studyModes(points.scene, mixedPoints(points, options.radius, options.seed), options, span.part(1, 2)),
        results);
    return results;
}

std::vector<SetResult> studyNearest(const BenchPoints& points, const SetStudyOptions& options,
                                    const ProgressSpan& span)
{
    constexpr std::uint32_t kNearest[] = {1, 8, 32};
    std::vector<SetResult> results;
    if (points.view.size() == 0) return results;
    for (std::size_t k = 0; k < std::size(kNearest); ++k) {
        SetSearch search(points.view, options.radius);
        search.nearest = kNearest[k];
        SetStudy study(points.scene, "one", search, options, span.part(k, std::size(kNearest)));
        study.addOurs();
        study.add("full", study.engine(), {points.view, options.radius});
        study.addFiltered("full-cut");
        study.addNearestAlone("nanoflann-k", kNearest[k]);
        study.addPeer("nanoflann-cut", "nanoflann-double", search);
        append(study.run(), results);
    }
    return results;
}

} // namespace vdb_nns::cli

#include "bench/studies/measure_study.h"

#include "bench/methods/measure_methods.h"
#include "bench/run_order.h"
#include "numbers.h"
#include "vdb_nns/error.h"

#include <algorithm>
#include <cstddef>
#include <memory>
#include <new>
#include <utility>

namespace vdb_nns::cli {
namespace {

constexpr const char* kMeasures[] = {"density", "normal", "pca"};
constexpr const char* kCounting = "count";
constexpr std::uint32_t kNearest = 32;

// A measure that a method is asked for.
struct Contender {
    std::string name, measure;
    std::shared_ptr<MeasureMethod> method;
    std::vector<double> grid = {}, pass = {}, total = {};
    MeasureErrors errors = {};
    std::string message = {};
    std::exception_ptr refusal = {};
};

class MeasureStudy {
public:
    MeasureStudy(const BenchPoints& points, const MeasureStudyOptions& options, const ProgressSpan& span)
        : mPoints(points), mOptions(options), mSpan(span)
    {
        span.printer.begin("truth", span.begin, middle());
        const Truth truth = findTruth(points.view, options.radius, options.truth);
        mIsComplete = truth.complete;
        mTruth = trueMeasures(points.view, options.radius, truth);
        addContenders();
    }

    std::vector<MeasureResult> run()
    {
        const ProgressSpan span{mSpan.printer, middle(), mSpan.end};
        const std::size_t count = mContenders.size();
        std::size_t step = 0;
        for (std::uint64_t run = 0; run <= mOptions.repeat; ++run) {
            for (const std::size_t k : orderOfRun(count, run)) {
                const ProgressSpan part = span.part(step++, count * (mOptions.repeat + 1));
                part.printer.begin("measure", part.begin, part.end);
                runOnce(mContenders[k], run);
            }
        }
        const Contender& counting = mContenders.front();
        const double countingSeconds = counting.pass.empty() ? 0 : median(counting.pass);
        std::vector<MeasureResult> results;
        for (const char* measure : kMeasures) {
            for (const Contender& contender : mContenders) {
                if (contender.measure == measure) results.push_back(summarize(contender, countingSeconds));
            }
        }
        return results;
    }

private:
    double middle() const { return mSpan.begin + 0.4 * (mSpan.end - mSpan.begin); }

    void addContenders()
    {
        const ParticleView& view = mPoints.view;
        const double radius = mOptions.radius, voxelSize = mOptions.voxelSize;
        const SearchOptions& search = mOptions.search;
        SearchOptions nearest = search;
        nearest.nearest = kNearest;
        const std::shared_ptr<MeasureMethod> ours = makeEngineMeasures(view, radius, search);
        mContenders.push_back({"counting", kCounting, ours});
        add("ours", ours);
        add("float32", makeFloatMeasures(view, radius, search, NeighborShare::kAll));
        add("half", makeFloatMeasures(view, radius, search, NeighborShare::kHalf));
        add("nearest" + std::to_string(kNearest), makeEngineMeasures(view, radius, nearest));
        add("fxpt16", makeStoredMeasures(view, radius, search, PositionCodec::kFixed16, voxelSize));
        add("fxpt8", makeStoredMeasures(view, radius, search, PositionCodec::kFixed8, voxelSize));
    }

    void add(const std::string& name, const std::shared_ptr<MeasureMethod>& method)
    {
        for (const char* measure : kMeasures) mContenders.push_back({name, measure, method});
    }

    // Run 0 warms up and is not counted; what the last one made is compared at once and let go.
    void runOnce(Contender& contender, std::uint64_t run)
    {
        if (!contender.message.empty()) return;
        try {
            const MeasureRun done = contender.method->run(contender.measure);
            if (run > 0) {
                contender.grid.push_back(done.gridSeconds);
                contender.pass.push_back(done.passSeconds);
                contender.total.push_back(done.gridSeconds + done.passSeconds);
            }
            if (run == mOptions.repeat && contender.measure != kCounting)
                contender.errors = findMeasureErrors(contender.measure, contender.method->values(), mTruth);
            contender.method->discard();
        } catch (const Cancelled&) {
            throw;
        } catch (const std::bad_alloc&) {
            refuse("asked for more memory than there is", contender);
        } catch (const Error& error) {
            refuse(error.what(), contender);
        }
    }

    static void refuse(const std::string& message, Contender& contender)
    {
        contender.message = message;
        contender.refusal = std::current_exception();
        contender.method->discard();
    }

    MeasureResult summarize(const Contender& contender, double countingSeconds) const
    {
        MeasureResult result;
        result.scene = mPoints.scene;
        result.measure = contender.measure;
        result.method = contender.name;
        result.isOurs = contender.name == "ours";
        result.points = mPoints.view.size();
        result.isComplete = mIsComplete;
        result.checkedQueries = mTruth.size();
        result.message = contender.message;
        result.refusal = contender.refusal;
        if (!result.message.empty()) return result;
        result.runs = contender.total.size();
        result.gridSeconds = median(contender.grid);
        result.passSeconds = median(contender.pass);
        result.totalSeconds = median(contender.total);
        result.minSeconds = *std::min_element(contender.total.begin(), contender.total.end());
        result.maxSeconds = *std::max_element(contender.total.begin(), contender.total.end());
        result.countingSeconds = countingSeconds;
        result.ratio = countingSeconds > 0 ? result.passSeconds / countingSeconds : 0;
        result.errors = contender.errors;
        return result;
    }

    const BenchPoints& mPoints;
    const MeasureStudyOptions& mOptions;
    const ProgressSpan mSpan;
    bool mIsComplete = false;
    std::vector<TrueMeasures> mTruth;
    std::vector<Contender> mContenders; // the one that counts is the first
};

} // namespace

std::vector<MeasureResult> studyMeasures(const BenchPoints& points, const MeasureStudyOptions& options,
                                         const ProgressSpan& span)
{
    if (points.view.size() == 0) return {};
    return MeasureStudy(points, options, span).run();
}

} // namespace vdb_nns::cli

#include "bench/studies/method_study.h"

#include "bench/run_order.h"
#include "machine.h"
#include "numbers.h"
#include "threads.h"
#include "vdb_nns/error.h"

#include <algorithm>
#include <atomic>
#include <memory>
#include <new>

namespace vdb_nns::cli {
namespace {

struct MethodTimes {
    std::vector<double> grid, search, total;
    std::vector<DeviceMeasures> device; // empty for a method of the CPU
    MethodRun last;
    double first = 0;
    std::uint64_t peakBytes = 0, addedBytes = 0, turn = 0;
    std::string message; // of a refusal; then nothing else is there
    std::exception_ptr refusal;
};

int threadsOf(const MethodSpec& spec, const MethodStudyOptions& options)
{
    return spec.threads > 0 ? spec.threads : options.threads;
}

MethodRun runOnce(Method& method, const MethodSpec& spec, const BenchPoints& points,
                  const MethodStudyOptions& options, const ProgressSpan& span)
{
    const int threads = threadsOf(spec, options);
    if (threads == options.threads) return method.run(points.view, options.radius, span);
    ThreadLimit limit(threads);
    return limit.run([&] { return method.run(points.view, options.radius, span); });
}

// One cold run of a method by itself: its first time and its peak of memory.
void measureCold(const MethodSpec& spec, const BenchPoints& points, const MethodStudyOptions& options,
                 const ProgressSpan& span, MethodTimes& times)
{
    returnFreedMemory();
    const std::uint64_t before = residentMemoryBytes();
    resetPeakMemory();
    try {
        const std::unique_ptr<Method> method = makeMethod(spec, options.setup);
        times.first = runOnce(*method, spec, points, options, span).totalSeconds();
    } catch (const Cancelled&) {
        throw;
    } catch (const DeviceError&) {
        throw;
    } catch (const std::bad_alloc&) {
        times.message = "asked for more memory than there is";
        times.refusal = std::current_exception();
    } catch (const std::exception& error) { // also what a peer throws
        times.message = error.what();
        times.refusal = std::current_exception();
    }
    times.peakBytes = peakMemoryBytes();
    times.addedBytes = times.peakBytes - std::min(times.peakBytes, before);
}

// Methods keep their buffers: those of one turn must fit the memory together.
void assignTurns(std::vector<MethodTimes>& times)
{
    const std::uint64_t most = machineMemoryBytes() / 2;
    std::uint64_t turn = 0, held = 0;
    for (MethodTimes& method : times) {
        if (held > 0 && most > 0 && held + method.addedBytes > most) {
            ++turn;
            held = 0;
        }
        held += method.addedBytes;
        method.turn = turn;
    }
}

void addRun(const MethodRun& run, MethodTimes& times)
{
    times.grid.push_back(run.gridSeconds);
    times.search.push_back(run.searchSeconds);
    times.total.push_back(run.totalSeconds());
    if (run.device) times.device.push_back(*run.device);
}

// Run 0 warms up and is not counted; the result of the last one stays, to be checked.
void measureTurn(const std::vector<std::unique_ptr<Method>>& methods, const BenchPoints& points,
                 const MethodStudyOptions& options, const ProgressSpan& span, std::vector<MethodTimes>& times)
{
    const double step = (span.end - span.begin) / static_cast<double>((options.repeat + 1) * methods.size());
    double from = span.begin;
    for (std::uint64_t run = 0; run <= options.repeat; ++run) {
        for (const std::size_t m : orderOfRun(methods.size(), run)) {
            from += step;
            if (!methods[m]) continue; // of another turn
            times[m].last =
                runOnce(*methods[m], options.methods[m], points, options, {span.printer, from - step, from});
            if (run < options.repeat) methods[m]->discard();
            if (run > 0) addRun(times[m].last, times[m]);
        }
    }
}

BenchResult summarize(const BenchPoints& points, const MethodSpec& spec, const MethodStudyOptions& options,
                      const MethodTimes& times)
{
    BenchResult result;
    result.scene = points.scene;
    result.method = spec.name;
    result.kind = spec.kind;
    result.threads = threadsOf(spec, options);
    result.points = points.view.size();
    result.pairs = times.last.pairs;
    result.radius = options.radius;
    result.message = times.message;
    result.refusal = times.refusal;
    if (!result.message.empty()) return result;
    result.runs = times.total.size();
    result.gridSeconds = median(times.grid);
    result.searchSeconds = median(times.search);
    result.totalSeconds = median(times.total);
    result.minSeconds = *std::min_element(times.total.begin(), times.total.end());
    result.maxSeconds = *std::max_element(times.total.begin(), times.total.end());
    result.firstSeconds = times.first;
    result.peakBytes = times.peakBytes;
    result.addedBytes = times.addedBytes;
    result.turn = times.turn;
    result.structureBytes = times.last.structureBytes;
    result.listBytes = times.last.listBytes;
    if (!times.device.empty()) result.device = medianOf(times.device);
    return result;
}

// As NeighborLists::checksum().
std::uint64_t checksumOf(const FoundNeighbors& found)
{
    std::atomic<std::uint64_t> sum{0};
    found.visitRows([&sum](std::uint32_t query, Span<const std::uint32_t> row) {
        std::uint64_t part = 0;
        for (const std::uint32_t other : row) part += mix64((std::uint64_t(query) << 32) + other);
        sum += part;
    });
    return sum;
}

BenchResult judge(const BenchPoints& points, const Truth& truth, const MethodSpec& spec,
                  const MethodStudyOptions& options, const MethodTimes& times, const FoundNeighbors& found)
{
    BenchResult result = summarize(points, spec, options, times);
    result.accuracy = checkAccuracy(found, points.view, options.radius, truth);
    if (spec.isExact() && found.hasRows()) result.checksum = checksumOf(found);
    return result;
}

void checkThreads(const MethodStudyOptions& options)
{
    for (const MethodSpec& spec : options.methods) {
        if (spec.threads > options.threads) {
            throw InvalidInput("--method " + spec.name + ": this bench has " +
                               std::to_string(options.threads) + " threads; raise --threads");
        }
    }
}

} // namespace

std::vector<BenchResult> studyMethods(const BenchPoints& points, const Truth& truth,
                                      const MethodStudyOptions& options, const ProgressSpan& span)
{
    checkThreads(options);
    const std::size_t count = options.methods.size();
    const ProgressSpan coldSpan = span.part(0, 5);
    const double cold = coldSpan.end;
    std::vector<MethodTimes> times(count);
    for (std::size_t m = 0; m < count; ++m)
        measureCold(options.methods[m], points, options, coldSpan.part(m, count), times[m]);
    assignTurns(times);

    std::vector<BenchResult> results;
    const std::uint64_t turns = count > 0 ? times.back().turn + 1 : 0;
    for (std::uint64_t turn = 0; turn < turns; ++turn) {
        const double share = (span.end - cold) / static_cast<double>(turns);
        const double from = cold + share * static_cast<double>(turn);
        std::vector<std::unique_ptr<Method>> methods(count);
        for (std::size_t m = 0; m < count; ++m) {
            if (times[m].turn == turn && times[m].message.empty())
                methods[m] = makeMethod(options.methods[m], options.setup);
        }
        measureTurn(methods, points, options, {span.printer, from, from + 0.8 * share}, times);
        span.printer.begin("check", from + 0.8 * share, from + share);
        for (std::size_t m = 0; m < count; ++m) {
            if (times[m].turn == turn && !times[m].message.empty())
                results.push_back(summarize(points, options.methods[m], options, times[m]));
            if (!methods[m]) continue;
            results.push_back(
                judge(points, truth, options.methods[m], options, times[m], methods[m]->found()));
            methods[m].reset();
        }
    }
    return results;
}

const BenchResult* firstThatDiffers(const std::vector<BenchResult>& results)
{
    const BenchResult* first = nullptr;
    std::optional<std::uint64_t> checksum;
    for (const BenchResult& result : results) {
        if (!result.isPromisedExact() || !result.message.empty()) continue;
        if (!first) first = &result;
        if (result.pairs != first->pairs) return &result;
        if (!result.checksum) continue;
        if (checksum && *checksum != *result.checksum) return &result;
        checksum = result.checksum;
    }
    return nullptr;
}

} // namespace vdb_nns::cli

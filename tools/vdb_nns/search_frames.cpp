#include "search_frames.h"

#include "exit_codes.h"
#include "failure.h"
#include "frame_numbers.h"
#include "frames_report.h"
#include "machine.h"
#include "search_run.h"
#include "signals.h"
#include "standard_streams.h"
#include "threads.h"
#include "vdb_nns/error.h"
#include "vdb_nns/memory.h"

#include <tbb/parallel_pipeline.h>

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <exception>
#include <filesystem>
#include <memory>
#include <mutex>
#include <unordered_map>
#include <utility>

namespace vdb_nns::cli {
namespace {

namespace fs = std::filesystem;

// A frame that is to be made, or not: with --skip-existing.
struct Frame {
    int number = 0;
    SearchFlags flags; // of this frame's files
    SearchPlan plan;
    std::vector<std::string> outputs; // those that are there, too
    bool isSkipped = false;
};

bool exists(const std::string& path)
{
    std::error_code error;
    return fs::exists(path, error);
}

std::vector<std::string> outputsOf(const SearchFlags& flags)
{
    std::vector<std::string> paths = flags.outputs;
    if (!flags.attributesOutput.empty()) paths.push_back(flags.attributesOutput);
    return paths;
}

SearchFlags flagsOfFrame(const SearchFlags& flags, int number)
{
    SearchFlags result = flags;
    std::vector<std::string*> paths = {&result.input.path, &result.query.queries, &result.query.radiusFile,
                                       &result.query.queriesRadiusFile, &result.attributesOutput};
    for (std::string& path : result.outputs) paths.push_back(&path);
    for (std::string* path : paths) *path = pathOfFrame(*path, number);
    return result;
}

void checkPatterns(const SearchFlags& flags)
{
    const std::string place = " has no place for the number of a frame; give e.g. ";
    if (!isFramePattern(flags.input.path))
        throw InvalidInput("--frames: " + flags.input.path + place + "in.####.vdb");
    const std::vector<std::string> outputs = outputsOf(flags);
    for (const std::string& path : outputs) {
        if (!isFramePattern(path))
            throw InvalidInput("--frames: " + path + place +
                               "out.####.npz, or every frame would be written there");
    }
    if (!flags.skipExisting) return;
    if (outputs.empty())
        throw InvalidInput("--skip-existing: no file is written that could exist; leave it out");
    if (flags.common.force)
        throw InvalidInput(
            "--skip-existing leaves alone what exists and --force replaces it; give one of them");
}

// The outputs that are not there yet. Flags about outputs that are left out go with them.
SearchFlags missingOutputs(const SearchFlags& flags)
{
    SearchFlags result = flags;
    result.outputs.erase(std::remove_if(result.outputs.begin(), result.outputs.end(), exists),
                         result.outputs.end());
    if (exists(result.attributesOutput)) result.attributesOutput.clear();
    result.givesKeep = false; // whether it suits was asked of all outputs
    const auto isOfPoints = [](const std::string& path) { return extensionOf(path) != ".npz"; };
    const bool hasPoints = std::any_of(result.outputs.begin(), result.outputs.end(), isOfPoints);
    if (!hasPoints && result.attributesOutput.empty()) {
        result.measure = MeasureFlags();
        result.measure.attributes = "count";
    }
    const auto isVdb = [](const std::string& path) { return extensionOf(path) == ".vdb"; };
    if (std::none_of(result.outputs.begin(), result.outputs.end(), isVdb)) result.voxelSize.clear();
    return result;
}

// One frame's output must be no other frame's file.
void checkApart(const std::vector<Frame>& frames, const std::string& report)
{
    std::unordered_map<std::string, int> owners;
    const auto named = [](const std::string& path) { return fs::path(path).lexically_normal().string(); };
    for (const Frame& frame : frames) {
        for (const std::string& path : frame.outputs) {
            const auto [owner, isNew] = owners.emplace(named(path), frame.number);
            if (!isNew && owner->second != frame.number)
                throw InvalidInput(path + ": would be written by the frames " +
                                   std::to_string(owner->second) + " and " + std::to_string(frame.number));
        }
    }
    if (!report.empty() && owners.count(named(report)) > 0)
        throw InvalidInput(report + ": is the target of two outputs; give the report a file of its own");
    for (const Frame& frame : frames) {
        std::vector<std::string> inputs = queryFiles(frame.flags.query);
        inputs.push_back(frame.flags.input.path);
        for (const std::string& path : inputs) {
            if (!report.empty()) checkNotInput(report, {path});
            const auto owner = owners.find(named(path));
            if (owner != owners.end() && owner->second != frame.number)
                throw InvalidInput(path + ": is read by frame " + std::to_string(frame.number) +
                                   " and would be written by frame " + std::to_string(owner->second));
        }
    }
}

std::vector<Frame> framesOf(const SearchFlags& flags)
{
    checkPatterns(flags);
    std::vector<Frame> frames;
    bool isAnyThere = false;
    for (const int number : parseFrames(flags.frames)) {
        Frame frame;
        frame.number = number;
        frame.flags = flagsOfFrame(flags, number);
        frame.plan = checkSearchFlags(frame.flags, {!flags.skipExisting, false});
        frame.outputs = outputsOf(frame.flags);
        if (flags.skipExisting) {
            frame.flags = missingOutputs(frame.flags);
            frame.isSkipped = outputsOf(frame.flags).empty();
            if (!frame.isSkipped) frame.plan = checkSearchFlags(frame.flags, {true, false});
        }
        isAnyThere = isAnyThere || frame.isSkipped || exists(frame.flags.input.path);
        frames.push_back(std::move(frame));
    }
    checkApart(frames, flags.common.json);
    if (!isAnyThere)
        throw InputError(flags.input.path + ": none of the frames " + flags.frames + " is there; " +
                         frames.front().flags.input.path + " would be the first");
    return frames;
}

// What the frames share while they run: progress, engines that are free, results.
class Frames {
public:
    Frames(const SearchFlags& flags, const Session& session, std::vector<Frame> frames, int threads)
        : mFlags(flags),
          mMemoryFlags(session.memoryFlags),
          mFrames(std::move(frames)),
          mThreads(threads),
          mProgress(progressMode(flags.common))
    {
        mResult.frames.resize(mFrames.size());
        for (std::size_t k = 0; k < mFrames.size(); ++k) {
            FrameReport& frame = mResult.frames[k];
            frame.number = mFrames[k].number;
            frame.path = mFrames[k].flags.input.path;
            frame.isSkipped = mFrames[k].isSkipped;
            if (!frame.isSkipped) mToMake.push_back(k);
        }
    }

    FramesReport run()
    {
        const Stopwatch total;
        mProgress.begin("frames", 0, 1);
        // A bound on memory is for one frame at a time, and so is the memory of devices, which an engine keeps.
        mIsBounded = !mFlags.engine.hostMemory.empty();
        const bool hasDevices = !mToMake.empty() && !mFrames[mToMake[0]].plan.job.device.devices.empty();
        mOverlaps = mThreads > 1 && !mIsBounded && !hasDevices;
        mFrameCount = static_cast<double>(mToMake.size());
        runAll();
        mOverlaps = false;
        mIsAlone = true;
        mToMake = std::exchange(mAlone, {});
        mNext = 0;
        runAll();
        throwIfStopped();
        mProgress.finish();
        mResult.seconds = total.seconds();
        mResult.peakBytes = std::max(mResult.peakBytes, peakMemoryBytes());
        return std::move(mResult);
    }

    void rethrowSummaryError() const
    {
        if (mSummaryError) std::rethrow_exception(mSummaryError);
    }

private:
    // A frame on its way.
    struct Work {
        Work(Frames& frames, std::size_t k)
            : session{frames.mFrames[k].flags.input.path, {}, {}, frames.mMemoryFlags},
              result(frames.mResult.frames[k]),
              place(k),
              progress(
                  [&frames, this](int percent) { frames.advance(percent - std::exchange(told, percent)); }),
              run(frames.mFrames[k].flags, frames.mFrames[k].plan, frames.mThreads, session)
        {
        }

        Session session;
        FrameReport& result;
        std::size_t place; // in mFrames
        bool goesAlone = false;
        int told = 0; // percent of this frame
        ProgressPrinter progress;
        std::unique_ptr<SearchEngine> engine;
        SearchRun run;
    };

    void runAll()
    {
        constexpr std::size_t kSteps = 3;
        constexpr auto kMode = tbb::filter_mode::serial_in_order;
        using Handle = std::shared_ptr<Work>;
        tbb::parallel_pipeline(
            mOverlaps ? kSteps : 1,
            tbb::make_filter<void, Handle>(kMode, [this](tbb::flow_control& flow) { return next(flow); }) &
                tbb::make_filter<Handle, Handle>(kMode,
                                                 [this](Handle work) { return find(std::move(work)); }) &
                tbb::make_filter<Handle, void>(kMode, [this](Handle work) { write(std::move(work)); }));
    }

    // A step of one frame, unless one before it failed. Nothing leaves it: where an exception ends the steps of other frames, they
    // would not know.
    template <typename F>
    void attempt(Work& work, F&& step)
    {
        if (stopSignal() != 0 || work.result.failure) return;
        try {
            step();
        } catch (...) {
            try {
                work.result.failure = failureOf(work.session);
            } catch (const Cancelled&) { // and so will be all others, by the same signal
                return;
            }
            // Alone it may have the room that it did not have beside others.
            work.goesAlone = mOverlaps && work.result.failure->code == kNoRoom;
            if (work.goesAlone) return;
            say("error: frame " + std::to_string(work.result.number) + ": " + work.result.failure->message);
        }
    }

    std::shared_ptr<Work> next(tbb::flow_control& flow)
    {
        if (mNext == mToMake.size() || stopSignal() != 0) {
            flow.stop();
            return nullptr;
        }
        if (mIsBounded || mIsAlone) {
            mEngines.clear();
            returnFreedMemory();
        }
        if (mIsBounded) resetPeakMemory(); // the bound is looked at for each frame
        const auto work = std::make_shared<Work>(*this, mToMake[mNext++]);
        attempt(*work, [&] { work->run.read(work->progress); });
        return work;
    }

    std::shared_ptr<Work> find(std::shared_ptr<Work> work)
    {
        attempt(*work, [&] {
            work->engine = takeEngine();
            work->run.find(*work->engine, work->progress);
        });
        return work;
    }

    void write(std::shared_ptr<Work> work)
    {
        attempt(*work, [&] {
            work->run.write(work->progress);
            work->result.report = work->run.report();
        });
        if (work->result.report) tell(work->result);
        if (work->goesAlone) {
            work->result.failure.reset();
            mAlone.push_back(work->place);
        }
        advance((work->goesAlone ? 0 : 100) - work->told);
        std::unique_ptr<SearchEngine> engine = std::move(work->engine);
        mResult.peakBytes = std::max(mResult.peakBytes, peakMemoryBytes());
        work.reset();                      // its lists, whose memory the engine can use again then
        if (!engine || mIsBounded) return; // what an engine keeps would be taken from the next frame's bound
        const std::lock_guard<std::mutex> lock(mMutex);
        mEngines.push_back(std::move(engine));
    }

    // The frame is made, whatever becomes of its line.
    void tell(const FrameReport& frame)
    {
        if (mFlags.common.quiet || jsonToStdout(mFlags.common) || mSummaryError) return;
        try {
            writeSummary(frameText(frame));
        } catch (const OutputError&) {
            mSummaryError = std::current_exception();
        }
    }

    std::unique_ptr<SearchEngine> takeEngine()
    {
        const std::lock_guard<std::mutex> lock(mMutex);
        if (mEngines.empty()) return std::make_unique<SearchEngine>();
        std::unique_ptr<SearchEngine> engine = std::move(mEngines.back());
        mEngines.pop_back();
        return engine;
    }

    void advance(int percent)
    {
        const std::int64_t sum = mPercents += percent;
        mProgress.update("frames", static_cast<double>(sum) / (100 * mFrameCount));
    }

    const SearchFlags& mFlags;
    const std::string mMemoryFlags;
    const std::vector<Frame> mFrames;
    const int mThreads;
    ProgressPrinter mProgress;
    std::vector<std::size_t> mToMake;       // places in mFrames
    double mFrameCount = 0;                 // that are to be made
    std::size_t mNext = 0;                  // in mToMake
    std::atomic<std::int64_t> mPercents{0}; // of all frames, summed
    bool mIsBounded = false, mOverlaps = false, mIsAlone = false;
    std::vector<std::size_t> mAlone; // frames that had no room beside others; places in mFrames
    std::mutex mMutex;
    std::vector<std::unique_ptr<SearchEngine>> mEngines; // that nobody uses
    std::exception_ptr mSummaryError;                    // of the first line that could not be written
    FramesReport mResult;
};

int exitCode(const FramesReport& report)
{
    const FrameReport* lowest = nullptr;
    for (const FrameReport& frame : report.frames) {
        if (frame.failure && (!lowest || frame.number < lowest->number)) lowest = &frame;
    }
    return lowest ? lowest->failure->code : kDone;
}

} // namespace

int searchFrames(const SearchFlags& flags, const Session& session)
{
    std::vector<Frame> frames = framesOf(flags);
    OutputOptions reportOutput = outputOptions(flags.common);
    reportOutput.overwrite |= flags.skipExisting; // the run before left one
    if (jsonToStdout(flags.common)) requireStdout();
    if (!flags.common.json.empty() && !jsonToStdout(flags.common))
        checkOutput(flags.common.json, reportOutput.overwrite);
    ThreadLimit threads(threadCount(flags.common));
    std::optional<DeviceOptions> device; // the same for all
    for (Frame& frame : frames) {
        if (frame.isSkipped) continue;
        if (!device) device = deviceOptions(deviceFor(frame.flags.device, frame.plan.query), threads.count());
        frame.plan.job.device = *device;
    }
    Frames work(flags, session, std::move(frames), threads.count());
    const FramesReport report = threads.run([&] { return work.run(); });
    const CommonFlags& common = flags.common;
    if (!common.json.empty()) deliverJson(common.json, framesReportJson(report), reportOutput);
    work.rethrowSummaryError();
    if (!common.quiet && !jsonToStdout(common)) writeSummary(framesReportText(report));
    return exitCode(report);
}

} // namespace vdb_nns::cli

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

#include <tbb/parallel_pipeline.h>

#include <algorithm>
#include <atomic>
#include <cstdint>
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

// One frame's output must be no other frame's file.
void checkApart(const std::vector<Frame>& frames)
{
    std::unordered_map<std::string, int> owners;
    const auto named = [](const std::string& path) { return fs::path(path).lexically_normal().string(); };
    for (const Frame& frame : frames) {
        for (const std::string& path : outputsOf(frame.flags)) {
            const auto [owner, isNew] = owners.emplace(named(path), frame.number);
            if (!isNew && owner->second != frame.number)
                throw InvalidInput(path + ": would be written by the frames " +
                                   std::to_string(owner->second) + " and " + std::to_string(frame.number));
        }
    }
    for (const Frame& frame : frames) {
        std::vector<std::string> inputs = queryFiles(frame.flags.query);
        inputs.push_back(frame.flags.input.path);
        for (const std::string& path : inputs) {
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
        if (flags.skipExisting) {
            const std::vector<std::string> outputs = outputsOf(frame.flags);
            frame.isSkipped = std::all_of(outputs.begin(), outputs.end(), exists);
            frame.flags.common.force = true; // where only some of them are there
        }
        if (!frame.isSkipped) frame.plan = checkSearchFlags(frame.flags);
        isAnyThere = isAnyThere || frame.isSkipped || exists(frame.flags.input.path);
        frames.push_back(std::move(frame));
    }
    checkApart(frames);
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
        const bool mayOverlap = mThreads > 1 && mFlags.engine.hostMemory.empty() &&
                                (mToMake.empty() || mFrames[mToMake[0]].plan.job.device.devices.empty());
        constexpr std::size_t kSteps = 3;
        constexpr auto kMode = tbb::filter_mode::serial_in_order;
        using Handle = std::shared_ptr<Work>;
        tbb::parallel_pipeline(
            mayOverlap ? kSteps : 1,
            tbb::make_filter<void, Handle>(kMode, [this](tbb::flow_control& flow) { return next(flow); }) &
                tbb::make_filter<Handle, Handle>(kMode,
                                                 [this](Handle work) { return find(std::move(work)); }) &
                tbb::make_filter<Handle, void>(kMode, [this](Handle work) { write(std::move(work)); }));
        throwIfStopped();
        mProgress.finish();
        mResult.seconds = total.seconds();
        mResult.peakBytes = peakMemoryBytes();
        return std::move(mResult);
    }

private:
    // A frame on its way.
    struct Work {
        Work(Frames& frames, std::size_t k)
            : session{frames.mFrames[k].flags.input.path, {}, {}, frames.mMemoryFlags},
              result(frames.mResult.frames[k]),
              progress(
                  [&frames, this](int percent) { frames.advance(percent - std::exchange(told, percent)); }),
              run(frames.mFrames[k].flags, frames.mFrames[k].plan, frames.mThreads, session)
        {
        }

        Session session;
        FrameReport& result;
        int told = 0; // percent of this frame
        ProgressPrinter progress;
        std::unique_ptr<SearchEngine> engine;
        SearchRun run;
    };

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
            say("error: frame " + std::to_string(work.result.number) + ": " + work.result.failure->message);
        }
    }

    std::shared_ptr<Work> next(tbb::flow_control& flow)
    {
        if (mNext == mToMake.size() || stopSignal() != 0) {
            flow.stop();
            return nullptr;
        }
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
            if (!mFlags.common.quiet && !jsonToStdout(mFlags.common)) writeSummary(frameText(work->result));
        });
        advance(100 - work->told);
        std::unique_ptr<SearchEngine> engine = std::move(work->engine);
        work.reset(); // its lists, whose memory the engine can use again then
        const std::lock_guard<std::mutex> lock(mMutex);
        if (engine) mEngines.push_back(std::move(engine));
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
        mProgress.update("frames", static_cast<double>(sum) / (100 * static_cast<double>(mToMake.size())));
    }

    const SearchFlags& mFlags;
    const std::string mMemoryFlags;
    const std::vector<Frame> mFrames;
    const int mThreads;
    ProgressPrinter mProgress;
    std::vector<std::size_t> mToMake;       // places in mFrames
    std::size_t mNext = 0;                  // in mToMake
    std::atomic<std::int64_t> mPercents{0}; // of all frames, summed
    std::mutex mMutex;
    std::vector<std::unique_ptr<SearchEngine>> mEngines; // that nobody uses
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
    if (!common.json.empty()) deliverJson(common.json, framesReportJson(report), outputOptions(common));
    if (!common.quiet && !jsonToStdout(common)) writeSummary(framesReportText(report));
    return exitCode(report);
}

} // namespace vdb_nns::cli

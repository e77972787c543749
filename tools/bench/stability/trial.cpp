#include "bench/stability/trial.h"

#include "bench/stability/trial_work.h"
#include "machine.h"
#include "progress_printer.h"
#include "report.h"

#include <algorithm>
#include <cerrno>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <dirent.h>
#include <fcntl.h>
#include <new>
#include <poll.h>
#include <stdexcept>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <thread>
#include <unistd.h>

namespace vdb_nns::cli {
namespace {

constexpr double kOtherSeconds =
    300;                    // for making particles, and for truth and comparison: no fault of the method
constexpr int kTickMs = 20; // SIGINT and deadlines are noticed so late at most

[[noreturn]] void failSystem(const char* call)
{
    throw std::runtime_error(std::string("bench --stability: ") + call + ": " + std::strerror(errno));
}

int threadsOfProcess()
{
    DIR* const tasks = opendir("/proc/self/task");
    if (!tasks) return 1;
    int threads = 0;
    while (const dirent* entry = readdir(tasks)) threads += entry->d_name[0] != '.';
    closedir(tasks);
    return threads;
}

// Those that libraries start when they are loaded: OpenVDB may bring log4cplus, which keeps a pool of idle ones.
const int kThreadsAtLoad = threadsOfProcess();

// A child has only the thread that forked: it would wait for TBB's workers for ever.
void requireNoWorkers()
{
    const int more = threadsOfProcess() - kThreadsAtLoad;
    if (more <= 0) return;
    throw std::runtime_error("bench --stability: this process has started " + std::to_string(more) +
                             " threads already, and trials are forked before anything runs in parallel");
}

class SharedRecord {
public:
    SharedRecord()
    {
        void* const memory =
            mmap(nullptr, sizeof(TrialRecord), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
        if (memory == MAP_FAILED) failSystem("mmap");
        mRecord = new (memory) TrialRecord;
    }
    ~SharedRecord() { munmap(mRecord, sizeof(TrialRecord)); }
    SharedRecord(const SharedRecord&) = delete;
    SharedRecord& operator=(const SharedRecord&) = delete;

    TrialRecord& operator*() const { return *mRecord; }

private:
    TrialRecord* mRecord;
};

// ---- the child ---------------------------------------------------------------------------------------------------------

void setDefaults(const TrialLimits& limits, int errors)
{
    prctl(PR_SET_PDEATHSIG, SIGKILL); // nobody is left who would end it
    for (int number = 1; number < NSIG; ++number) std::signal(number, SIG_DFL);
    const rlimit noCore = {0, 0};
    setrlimit(RLIMIT_CORE, &noCore);
    const auto cores = std::max(1u, std::thread::hardware_concurrency());
    const auto cpuSeconds = static_cast<rlim_t>((limits.seconds * 4 + 2 * kOtherSeconds) * 2 * cores) + 1;
    const rlimit cpu = {cpuSeconds, cpuSeconds + 10};
    setrlimit(RLIMIT_CPU, &cpu);
    const int nothing = open("/dev/null", O_RDWR);
    dup2(nothing, STDIN_FILENO);
    dup2(nothing, STDOUT_FILENO);
    dup2(errors, STDERR_FILENO);
    // Should a method call exit(), nothing of the parent's is flushed, and no library waits for threads that are not here.
    on_exit([](int status, void*) { _exit(status); }, nullptr);
}

[[noreturn]] void beChild(const StabilityCase& stabilityCase, const MethodSpec& spec,
                          const TrialLimits& limits, const MethodMaker& make, int errors, TrialRecord& record)
{
    setDefaults(limits, errors);
    try {
        doTrial(stabilityCase, spec, limits, make, record);
        record.enter(TrialPhase::kDone);
    } catch (const std::exception& e) {
        record.say(e.what());
        record.enter(TrialPhase::kFailed);
    }
    _exit(0);
}

// ---- the parent --------------------------------------------------------------------------------------------------------

class Child {
public:
    Child(pid_t pid, int errors) : mPid(pid), mErrors(errors) {}
    ~Child()
    {
        kill();
        close(mErrors);
    }
    Child(const Child&) = delete;
    Child& operator=(const Child&) = delete;

    /// Reads what it prints, for a tick or until it ends. Whether it has ended.
    bool wait()
    {
        pollfd watched = {mIsOpen ? mErrors : -1, POLLIN, 0};
        if (poll(&watched, 1, mIsOpen ? kTickMs : 1) > 0) read();
        return reap(WNOHANG);
    }

    void kill()
    {
        if (mHasEnded) return;
        ::kill(mPid, SIGKILL);
        reap(0);
    }

    int status() const { return mStatus; }
    std::uint64_t peakBytes() const { return static_cast<std::uint64_t>(mUsage.ru_maxrss) * 1024; }

    std::string lastLine()
    {
        while (mIsOpen) read(); // what it wrote before it ended
        while (!mText.empty() && std::strchr("\r\n ", mText.back())) mText.pop_back();
        return mText.substr(mText.find_last_of("\r\n") + 1);
    }

private:
    void read()
    {
        char some[4096];
        const ssize_t bytes = ::read(mErrors, some, sizeof some);
        if (bytes < 0 && errno == EINTR) return;
        if (bytes <= 0) {
            mIsOpen = false;
            return;
        }
        mText.append(some, static_cast<std::size_t>(bytes));
        if (mText.size() > sizeof some) mText.erase(0, mText.size() - sizeof some);
    }

    bool reap(int flags)
    {
        if (mHasEnded) return true;
        pid_t ended = 0;
        while ((ended = wait4(mPid, &mStatus, flags, &mUsage)) < 0 && errno == EINTR) {
        }
        mHasEnded = ended != 0;
        return mHasEnded;
    }

    const pid_t mPid;
    const int mErrors;
    bool mIsOpen = true, mHasEnded = false;
    int mStatus = 0;
    rusage mUsage = {};
    std::string mText;
};

std::string signalName(int number)
{
    switch (number) {
    case SIGSEGV:
        return "SIGSEGV";
    case SIGABRT:
        return "SIGABRT";
    case SIGBUS:
        return "SIGBUS";
    case SIGFPE:
        return "SIGFPE";
    case SIGILL:
        return "SIGILL";
    case SIGKILL:
        return "SIGKILL";
    case SIGTERM:
        return "SIGTERM";
    case SIGXCPU:
        return "SIGXCPU";
    default:
        return "signal " + std::to_string(number);
    }
}

// Whether it is the method that died, and not the case.
bool isOfMethod(TrialPhase phase)
{
    return phase == TrialPhase::kRun || phase == TrialPhase::kCheck;
}

void describeDeath(Child& child, TrialPhase phase, StabilityTrial& trial)
{
    const int status = child.status();
    const std::string said = child.lastLine();
    if (WIFSIGNALED(status)) {
        const int number = WTERMSIG(status);
        trial.verdict = number == SIGKILL
                            ? Verdict::kMemory // the kernel's own way out; ours is told apart before
                        : number == SIGXCPU ? Verdict::kHang
                                            : Verdict::kCrash;
        trial.message = signalName(number);
    } else {
        trial.verdict = Verdict::kCrash;
        trial.message = "ended the program with status " + std::to_string(WEXITSTATUS(status));
    }
    if (phase == TrialPhase::kCheck) trial.message += ", while its result was read";
    if (!said.empty()) trial.message += ": " + said;
}

// Until the child ends; whether it had to be killed.
bool waitFor(Child& child, const TrialRecord& record, const TrialLimits& limits)
{
    while (!child.wait()) {
        throwIfStopped();
        const double allowed = record.phase == TrialPhase::kRun ? limits.seconds : kOtherSeconds;
        if (monotonicSeconds() - record.phaseBegan <= allowed) continue;
        child.kill();
        return true;
    }
    throwIfStopped(); // a terminal sends SIGINT to both
    return false;
}

void takeResult(const TrialRecord& record, StabilityTrial& trial)
{
    trial.verdict = record.verdict;
    trial.missing = record.missing;
    trial.extra = record.extra;
    trial.duplicates = record.duplicates;
    trial.wrongValues = record.wrongValues;
    if (record.hasAsymmetric) trial.asymmetric = record.asymmetric;
    trial.seconds = record.seconds;
    trial.peakBytes = record.peakBytes;
    trial.message = record.message;
}

StabilityTrial describe(const StabilityCase& stabilityCase, const MethodSpec& spec)
{
    StabilityTrial trial;
    trial.caseName = stabilityCase.name;
    trial.group = stabilityCase.group;
    trial.what = stabilityCase.what;
    trial.method = spec.name;
    trial.isExact = spec.isExact();
    trial.right = stabilityCase.rightOutcome(spec);
    return trial;
}

} // namespace

const char* verdictName(Verdict verdict)
{
    switch (verdict) {
    case Verdict::kExact:
        return "exact";
    case Verdict::kWrong:
        return "wrong";
    case Verdict::kRefused:
        return "refused";
    case Verdict::kCrash:
        return "crash";
    case Verdict::kHang:
        return "hang";
    case Verdict::kMemory:
        return "memory";
    case Verdict::kSkipped:
        break;
    }
    return "skipped";
}

StabilityTrial runTrial(const StabilityCase& stabilityCase, const MethodSpec& spec, const TrialLimits& limits,
                        const MethodMaker& make)
{
    throwIfStopped();
    requireNoWorkers();
    const SharedRecord shared;
    TrialRecord& record = *shared;
    record.enter(TrialPhase::kMake);
    int errors[2];
    if (pipe2(errors, O_CLOEXEC) != 0) failSystem("pipe");
    const pid_t pid = fork();
    if (pid < 0) failSystem("fork");
    if (pid == 0) beChild(stabilityCase, spec, limits, make, errors[1], record);
    close(errors[1]);
    Child child(pid, errors[0]);
    const bool isKilled = waitFor(child, record, limits);

    StabilityTrial trial = describe(stabilityCase, spec);
    const TrialPhase phase = record.phase;
    const bool isDone = phase == TrialPhase::kDone || phase == TrialPhase::kFailed;
    if (phase == TrialPhase::kFailed || (!isDone && !isOfMethod(phase))) {
        const std::string said = *record.message ? record.message : child.lastLine();
        throw std::runtime_error("bench --stability: the case " + stabilityCase.name + " with " + spec.name +
                                 " failed by itself: " + said);
    }
    takeResult(record, trial);
    trial.isClear = trial.message.find(stabilityCase.refusalSays) != std::string::npos;
    if (isDone && !isKilled) return trial;
    if (phase == TrialPhase::kRun) trial.seconds += monotonicSeconds() - record.phaseBegan;
    trial.peakBytes =
        std::max(trial.peakBytes, child.peakBytes() - std::min(child.peakBytes(), record.bytesBefore));
    if (isKilled) {
        trial.verdict = Verdict::kHang;
        trial.message =
            format("stopped after %.3g seconds", phase == TrialPhase::kRun ? limits.seconds : kOtherSeconds);
        if (phase == TrialPhase::kCheck) trial.message += ", while its result was read";
    } else {
        describeDeath(child, phase, trial);
    }
    return trial;
}

} // namespace vdb_nns::cli

#include "signals.h"

#include "exit_codes.h"
#include "vdb_nns/output.h"

#include <atomic>
#include <csignal>
#include <cstring>
#include <ctime>
#include <unistd.h>

namespace vdb_nns::cli {
namespace {

std::atomic<int> gStopSignal{0};
timer_t gDeadline;
bool gHasDeadline = false, gClearsLine = false; // set before any signal is handled
static_assert(std::atomic<int>::is_always_lock_free, "a signal handler may only touch lock-free atomics");

// Dies of the signal once the handler returns.
void killAtOnce(int signal)
{
    removeTemporaryFiles();
    struct sigaction action = {};
    action.sa_handler = SIG_DFL;
    sigaction(signal, &action, nullptr);
    raise(signal);
}

// Ends the program where its steps have not stopped in time: they are in a library's code that asks nobody, or free what they
// hold. Only calls that a signal handler may make.
void endAtOnce(int)
{
    removeTemporaryFiles();
    const int signal = gStopSignal;
    const char* const text = stopMessage(signal);
    if (gClearsLine) (void)!write(STDERR_FILENO, "\r\033[K", 4);
    (void)!write(STDERR_FILENO, text, std::strlen(text));
    _exit(stopCode(signal));
}

void setDeadline(long nanoseconds)
{
    itimerspec time = {};
    time.it_value.tv_nsec = nanoseconds;
    if (gHasDeadline) timer_settime(gDeadline, 0, &time, nullptr);
}

void askToStop(int signal)
{
    constexpr long kPatience =
        150'000'000; // of 0.3 s in which the program is to be gone, its memory given back
    int none = 0;
    if (!gStopSignal.compare_exchange_strong(none, signal)) return killAtOnce(signal);
    setDeadline(kPatience);
}

void handle(int signal, void (*handler)(int))
{
    struct sigaction action = {};
    action.sa_handler = handler;
    sigemptyset(&action.sa_mask);
    action.sa_flags = SA_RESTART;
    sigaction(signal, &action, nullptr);
}

bool isIgnored(int signal)
{
    struct sigaction action = {};
    return sigaction(signal, nullptr, &action) == 0 && action.sa_handler == SIG_IGN;
}

} // namespace

void installSignalHandlers()
{
    gClearsLine = isatty(STDERR_FILENO);
    sigevent event = {};
    event.sigev_notify = SIGEV_SIGNAL;
    event.sigev_signo = SIGRTMIN;
    gHasDeadline = timer_create(CLOCK_MONOTONIC, &event, &gDeadline) == 0;
    handle(SIGRTMIN, endAtOnce);
    // Also where a shell started us in the background with SIGINT ignored: whoever sends it by hand means it.
    handle(SIGINT, askToStop);
    handle(SIGTERM, askToStop);
    if (!isIgnored(SIGHUP)) handle(SIGHUP, askToStop); // nohup ignores it
    // What schedulers, timers and abort() send, whose default is to end the process.
    for (const int signal : {SIGQUIT, SIGABRT, SIGUSR1, SIGUSR2, SIGXCPU, SIGALRM, SIGVTALRM, SIGPROF}) {
        if (!isIgnored(signal)) handle(signal, killAtOnce);
    }
    handle(SIGPIPE, SIG_IGN);
    handle(SIGXFSZ, SIG_IGN);
}

int stopSignal()
{
    return gStopSignal.load(std::memory_order_relaxed);
}

void stopDeadline()
{
    setDeadline(0);
}

const char* stopMessage(int signal)
{
    return signal == SIGHUP    ? "vdb_nns: stopped by SIGHUP\n"
           : signal == SIGTERM ? "vdb_nns: stopped by SIGTERM\n"
                               : "vdb_nns: stopped by SIGINT\n";
}

int stopCode(int signal)
{
    return signal == SIGHUP ? kHungUp : signal == SIGTERM ? kTerminated : kInterrupted;
}

} // namespace vdb_nns::cli

#include "signals.h"

#include "vdb_nns/output.h"

#include <atomic>
#include <csignal>

namespace vdb_nns::cli {
namespace {

std::atomic<int> gStopSignal{0};
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

void askToStop(int signal)
{
    int none = 0;
    if (!gStopSignal.compare_exchange_strong(none, signal)) killAtOnce(signal);
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

} // namespace vdb_nns::cli

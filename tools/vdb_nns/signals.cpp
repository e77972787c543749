#include "signals.h"

#include <atomic>
#include <csignal>

namespace vdb_nns::cli {
namespace {

std::atomic<int> gStopSignal{0};
static_assert(std::atomic<int>::is_always_lock_free, "a signal handler may only touch lock-free atomics");

void rememberSignal(int signal)
{
    gStopSignal.store(signal, std::memory_order_relaxed);
}

} // namespace

void installSignalHandlers()
{
    struct sigaction stop = {};
    stop.sa_handler = rememberSignal;
    sigemptyset(&stop.sa_mask);
    // Reset: the second one takes the default action. Targets cannot be left half written by it: they are
    // temporary files until the rename.
    stop.sa_flags = SA_RESTART | SA_RESETHAND;
    // Also where a shell started us in the background with SIGINT ignored: whoever sends it by hand means it.
    sigaction(SIGINT, &stop, nullptr);
    sigaction(SIGTERM, &stop, nullptr);

    struct sigaction ignore = {};
    ignore.sa_handler = SIG_IGN;
    sigemptyset(&ignore.sa_mask);
    sigaction(SIGPIPE, &ignore, nullptr);
    sigaction(SIGXFSZ, &ignore, nullptr);
}

int stopSignal()
{
    return gStopSignal.load(std::memory_order_relaxed);
}

} // namespace vdb_nns::cli

#include "thread_failure.h"

#include "exit_codes.h"
#include "vdb_nns/output.h"

#include <atomic>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <new>
#include <stdexcept>
#include <system_error>

#include <unistd.h>

namespace vdb_nns::cli {
namespace {

std::terminate_handler gDefaultHandler = nullptr;

[[noreturn]] void explainNoMemory()
{
    std::fputs(
        "vdb_nns: error: the memory is used up; allow more address space (ulimit -v), or use a machine with "
        "more memory\n",
        stderr);
    ::_exit(kNoRoom);
}

[[noreturn]] void explainTermination()
{
    claimEnd();
    removeTemporaryFiles();
    try {
        if (std::current_exception()) throw;
    } catch (const std::bad_alloc&) {
        explainNoMemory();
    } catch (const std::exception& error) {
        if (isThreadFailure(error)) {
            std::fprintf(stderr, "vdb_nns: error: %s\n", threadAdvice(error).c_str());
            ::_exit(kNoRoom);
        }
    } catch (...) {
    }
    gDefaultHandler();
    std::abort();
}

void prepareForLibraries()
{
    gDefaultHandler = std::set_terminate(explainTermination);
    // Without memory the initialisers of oneTBB (2022.1) crash. Those of log4cplus have taken the stacks of four threads by then, of
    // 8 MiB as a rule; the rest is for TBB.
    constexpr std::size_t kOfLibraries = std::size_t(48) << 20;
    if (!isFree(kOfLibraries)) explainNoMemory();
}

// Runs before the initialisers of the shared libraries.
[[gnu::section(".preinit_array"), gnu::used]] void (*const kBeforeLibraries)() = prepareForLibraries;

} // namespace

bool isFree(std::size_t bytes)
{
    void* volatile const block = std::malloc(bytes); // a call that no compiler leaves out
    std::free(block);
    return block != nullptr;
}

void claimEnd()
{
    static std::atomic<pid_t> sEnding{0};
    const pid_t own = ::gettid();
    pid_t first = 0;
    if (sEnding.compare_exchange_strong(first, own) || first == own) return;
    for (;;) ::pause();
}

bool isThreadFailure(const std::exception& error)
{
    if (const auto* system = dynamic_cast<const std::system_error*>(&error)) {
        return system->code() == std::errc::resource_unavailable_try_again;
    }
    // TBB's has no type of its own.
    return std::strncmp(error.what(), "pthread_create", std::strlen("pthread_create")) == 0;
}

std::string threadAdvice(const std::exception& error)
{
    return std::string("the system makes no more threads (") + error.what() +
           "): use fewer with --threads, or allow more processes (ulimit -u) or address space (ulimit -v)";
}

} // namespace vdb_nns::cli

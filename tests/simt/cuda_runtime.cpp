// The machine under cuda_runtime_api.h. One lock is held from a call's start to its end, also while work
// runs. A refusal is thrown, as its code, up to call().
#include "cuda_runtime_api.h"

#include <algorithm>
#include <deque>
#include <exception>
#include <list>
#include <map>
#include <memory>
#include <mutex>
#include <random>
#include <set>
#include <string>
#include <utility>

struct CUstream_st {
    int device;
    std::deque<std::function<void()>> queue = {};
    bool isLive = true; // its work outlives it
};

struct CUevent_st {
    struct Record {
        CUstream_st& stream;
        long tick = 0; // when the stream came to it
    };
    int device;
    unsigned flags;
    std::shared_ptr<Record> last = nullptr;
    bool isLive = true;
};

namespace {

constexpr int kHost = -1; // in place of a device's number

struct Allocation {
    std::unique_ptr<std::byte[]> data;
    std::size_t bytes;
    int device;
    unsigned flags;
};

/// Throws the code that the call then returns.
void require(bool condition, cudaError_t code)
{
    if (!condition) throw code;
}

struct Machine {
    std::mt19937_64 random;
    std::uint64_t eagerness = 0; // in quarters: how likely it is that a call runs one more piece of work
    std::vector<std::size_t> totalBytes;
    std::map<int, std::size_t> usedBytes;
    std::map<const std::byte*, Allocation> allocations;
    std::list<CUstream_st> streams; // destroyed ones stay, so that no handle comes twice
    std::list<CUevent_st> events;   // likewise
    std::map<std::string, std::pair<int, cudaError_t>> failures;
    std::set<std::pair<int, const void*>> kernels; // loaded, with the device
    long tick = 0;                                 // pieces of work so far
    bool isBroken = false;
    std::exception_ptr thrown;

    template <class T>
    static T& find(std::list<T>& all, const T* handle)
    {
        for (T& one : all)
            if (&one == handle && one.isLive) return one;
        throw cudaErrorInvalidResourceHandle;
    }

    CUstream_st& live(cudaStream_t stream) { return find(streams, stream); }
    CUevent_st& live(cudaEvent_t event) { return find(events, event); }

    int known(int device) const
    {
        require(device >= 0 && device < static_cast<int>(totalBytes.size()), cudaErrorInvalidDevice);
        return device;
    }

    void load(int device, const void* kernel)
    {
        if (kernels.count({device, kernel}) > 0) return;
        require(simt::kKernelBytes <= totalBytes[known(device)] - usedBytes[device],
                cudaErrorMemoryAllocation);
        usedBytes[device] += simt::kKernelBytes;
        kernels.insert({device, kernel});
    }

    void* allocate(std::size_t bytes, int device, unsigned flags)
    {
        if (bytes == 0) return nullptr;
        require(device == kHost || bytes <= totalBytes[known(device)] - usedBytes[device],
                cudaErrorMemoryAllocation);
        usedBytes[device] += bytes;
        std::byte* const first = new std::byte[bytes];
        std::generate_n(first, bytes, [this] { return static_cast<std::byte>(random()); });
        allocations[first] = {std::unique_ptr<std::byte[]>(first), bytes, device, flags};
        return first;
    }

    const Allocation& allocationAt(const void* first, std::size_t bytes, bool onHost, cudaError_t code) const
    {
        const std::byte* const address = static_cast<const std::byte*>(first);
        auto found = allocations.upper_bound(address);
        require(found != allocations.begin(), code);
        const auto& [start, allocation] = *--found;
        const std::size_t offset = static_cast<std::size_t>(address - start);
        require(offset < allocation.bytes && bytes <= allocation.bytes - offset, code);
        require((allocation.device == kHost) == onHost, code);
        return allocation;
    }

    /// Device memory, or host memory that the device sees.
    void requireOnDevice(const void* first, std::size_t bytes, cudaError_t code) const
    {
        const bool isMapped = std::any_of(allocations.begin(), allocations.end(), [&](const auto& entry) {
            const auto offset = static_cast<std::size_t>(static_cast<const std::byte*>(first) - entry.first);
            return entry.second.flags == cudaHostAllocMapped && offset < entry.second.bytes;
        });
        allocationAt(first, bytes, isMapped, code);
    }

    void release(void* first, bool onHost)
    {
        if (!first) return;
        const Allocation& freed = allocationAt(first, 0, onHost, cudaErrorInvalidValue);
        require(freed.data.get() == first, cudaErrorInvalidValue);
        usedBytes[freed.device] -= freed.bytes;
        allocations.erase(freed.data.get());
    }

    void runFirst(CUstream_st& stream)
    {
        const std::function<void()> work = std::move(stream.queue.front());
        stream.queue.pop_front();
        ++tick;
        try {
            if (!isBroken) work();
        } catch (...) {
            isBroken = true;
            thrown = std::current_exception();
        }
    }

    void runAll(CUstream_st& stream)
    {
        while (!stream.queue.empty()) runFirst(stream);
        rethrow();
    }

    void runUpTo(const std::shared_ptr<CUevent_st::Record>& record)
    {
        while (record && record->tick == 0 && !record->stream.queue.empty()) runFirst(record->stream);
    }

    void runSome()
    {
        while (random() % 4 < eagerness) {
            std::vector<CUstream_st*> busy;
            for (CUstream_st& stream : streams)
                if (!stream.queue.empty()) busy.push_back(&stream);
            if (!busy.empty()) runFirst(*busy[random() % busy.size()]);
        }
    }

    void rethrow()
    {
        if (thrown) std::rethrow_exception(std::exchange(thrown, nullptr));
    }
};

std::mutex gMutex;
// Made when it is first asked for: a program may set it up before its main().
Machine& machine()
{
    static Machine made;
    return made;
}

thread_local int tDevice = 0;
thread_local cudaError_t tLastError = cudaSuccess;

template <class Action>
cudaError_t call(const char* name, const Action& action)
{
    const std::lock_guard<std::mutex> lock(gMutex);
    try {
        const auto failure = machine().failures.find(name);
        if (failure != machine().failures.end() && failure->second.first-- == 0)
            throw machine().failures.extract(failure).mapped().second;
        machine().runSome();
        action();
        return cudaSuccess;
    } catch (cudaError_t code) {
        return tLastError = code;
    }
}

} // namespace

// Statements in place of a body; call() does what all calls do.
#define SIMT_CALL(name, parameters, ...)                                                                     \
    cudaError_t name parameters                                                                              \
    {                                                                                                        \
        return call(#name, [&] { __VA_ARGS__; });                                                            \
    }

SIMT_CALL(cudaGetDeviceCount, (int* count), {
    *count = static_cast<int>(machine().totalBytes.size());
    require(*count > 0, cudaErrorNoDevice);
})
SIMT_CALL(cudaGetDeviceProperties, (cudaDeviceProp * all, int device),
          *all = {"SIMT emulation", machine().totalBytes[machine().known(device)], 9, 0, 4, 0, device + 1, 0})
SIMT_CALL(cudaFuncGetAttributes, (cudaFuncAttributes * all, const void* kernel), {
    machine().load(tDevice, kernel);
    *all = {};
})
SIMT_CALL(cudaSetDevice, (int device), tDevice = machine().known(device))
SIMT_CALL(cudaGetDevice, (int* device), *device = tDevice)
SIMT_CALL(cudaDriverGetVersion, (int* version), *version = 12000)
SIMT_CALL(cudaRuntimeGetVersion, (int* version), *version = 12000)
SIMT_CALL(cudaMemGetInfo, (size_t * freeBytes, size_t* totalBytes), {
    *totalBytes = machine().totalBytes[machine().known(tDevice)];
    *freeBytes = *totalBytes - machine().usedBytes[tDevice];
})
SIMT_CALL(cudaMalloc, (void** first, size_t n), *first = machine().allocate(n, tDevice, 0))
SIMT_CALL(cudaFree, (void* first), machine().release(first, false))
SIMT_CALL(cudaHostAlloc, (void** first, size_t n, unsigned flags),
          *first = machine().allocate(n, kHost, flags))
SIMT_CALL(cudaFreeHost, (void* first), machine().release(first, true))
SIMT_CALL(cudaHostGetDevicePointer, (void** onDevice, void* onHost, unsigned), {
    const Allocation& allocation = machine().allocationAt(onHost, 0, true, cudaErrorInvalidValue);
    require(allocation.flags & cudaHostAllocMapped, cudaErrorInvalidValue);
    *onDevice = onHost;
})

SIMT_CALL(cudaStreamCreateWithFlags, (cudaStream_t * stream, unsigned),
          *stream = &machine().streams.emplace_back(CUstream_st{machine().known(tDevice)}))
SIMT_CALL(cudaStreamDestroy, (cudaStream_t stream), machine().live(stream).isLive = false)
SIMT_CALL(cudaStreamSynchronize, (cudaStream_t stream), machine().runAll(machine().live(stream)))
SIMT_CALL(cudaStreamWaitEvent, (cudaStream_t waiting, cudaEvent_t event, unsigned),
          machine().live(waiting).queue.push_back([last = machine().live(event).last] {
              machine().runUpTo(last);
          }))
SIMT_CALL(cudaDeviceSynchronize, (), {
    for (CUstream_st& stream : machine().streams)
        if (stream.device == tDevice) machine().runAll(stream);
})

SIMT_CALL(cudaEventCreateWithFlags, (cudaEvent_t * event, unsigned flags),
          *event = &machine().events.emplace_back(CUevent_st{machine().known(tDevice), flags}))
SIMT_CALL(cudaEventDestroy, (cudaEvent_t event), machine().live(event).isLive = false)
SIMT_CALL(cudaEventRecord, (cudaEvent_t event, cudaStream_t stream), {
    require(machine().live(event).device == machine().live(stream).device, cudaErrorInvalidResourceHandle);
    event->last = std::make_shared<CUevent_st::Record>(CUevent_st::Record{*stream});
    stream->queue.push_back([record = event->last] { record->tick = machine().tick; });
})
SIMT_CALL(cudaEventSynchronize, (cudaEvent_t event), machine().runUpTo(machine().live(event).last);
          machine().rethrow())
SIMT_CALL(cudaEventQuery, (cudaEvent_t event), {
    const auto& record = machine().live(event).last;
    machine().rethrow();
    require(!record || record->tick > 0 || machine().isBroken, cudaErrorNotReady);
})
SIMT_CALL(cudaEventElapsedTime, (float* milliseconds, cudaEvent_t start, cudaEvent_t end), {
    const bool isTimed =
        !((machine().live(start).flags | machine().live(end).flags) & cudaEventDisableTiming);
    require(isTimed && start->last && end->last, cudaErrorInvalidResourceHandle);
    require(start->last->tick > 0 && end->last->tick > 0, cudaErrorNotReady);
    *milliseconds = 0.001f * static_cast<float>(end->last->tick - start->last->tick);
})

// Memory may be freed between call and copy, so both check.
SIMT_CALL(cudaMemcpyAsync, (void* to, const void* from, size_t n, cudaMemcpyKind kind, cudaStream_t stream), {
    if (n == 0) return;
    const auto check = [=](cudaError_t code) {
        machine().allocationAt(to, n, kind == cudaMemcpyDeviceToHost, code);
        machine().allocationAt(from, n, kind == cudaMemcpyHostToDevice, code);
    };
    check(cudaErrorInvalidValue);
    machine().live(stream).queue.push_back([=] { check(cudaErrorIllegalAddress), std::memcpy(to, from, n); });
})
SIMT_CALL(cudaMemsetAsync, (void* to, int value, size_t n, cudaStream_t stream), {
    if (n == 0) return;
    const auto check = [=](cudaError_t code) { machine().requireOnDevice(to, n, code); };
    check(cudaErrorInvalidValue);
    machine().live(stream).queue.push_back(
        [=] { check(cudaErrorIllegalAddress), std::memset(to, value, n); });
})

cudaError_t cudaGetLastError()
{
    return std::exchange(tLastError, cudaSuccess);
}

cudaError_t cudaPeekAtLastError()
{
    return tLastError;
}

const char* cudaGetErrorName(cudaError_t code)
{
#define SIMT_NAME(name, code)                                                                                \
    {                                                                                                        \
        code, #name                                                                                          \
    }
    return std::map<int, const char*>{SIMT_CUDA_ERRORS(SIMT_NAME)}.at(code);
}

const char* cudaGetErrorString(cudaError_t code)
{
    return cudaGetErrorName(code);
}

namespace simt {

void resetMachine(const std::vector<std::size_t>& bytesOfEachDevice, std::uint64_t seed)
{
    const std::lock_guard<std::mutex> lock(gMutex);
    machine() = Machine();
    machine().random.seed(seed);
    machine().eagerness = 1 + machine().random() % 3;
    machine().totalBytes = bytesOfEachDevice;
    tDevice = 0;
    tLastError = cudaSuccess;
}

void fail(const char* callName, int afterCalls, cudaError_t code)
{
    const std::lock_guard<std::mutex> lock(gMutex);
    machine().failures[callName] = {afterCalls, code};
}

std::size_t liveAllocations()
{
    const std::lock_guard<std::mutex> lock(gMutex);
    std::size_t count = machine().allocations.size();
    for (const CUstream_st& stream : machine().streams) count += stream.isLive;
    for (const CUevent_st& event : machine().events) count += event.isLive;
    return count;
}

std::size_t loadedKernels()
{
    const std::lock_guard<std::mutex> lock(gMutex);
    return machine().kernels.size();
}

void enqueueLaunch(const void* kernel, cudaStream_t stream,
                   const std::function<void(std::uint64_t seed)>& run)
{
    call("launch", [&] {
        require(machine().live(stream).device == tDevice, cudaErrorInvalidResourceHandle);
        machine().load(tDevice, kernel);
        stream->queue.push_back([run, seed = machine().random()] { run(seed); });
    });
}

} // namespace simt

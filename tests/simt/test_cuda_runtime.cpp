// The fake of CUDA's runtime API, before any host code is judged by it: what it refuses, in what order it
// runs work, and planted faults that must show under some seed.
#include "simt/simt.h"

#include <cuda_runtime_api.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cstring>
#include <string>
#include <thread>
#include <vector>

namespace vdb_nns::testing {

namespace {

constexpr std::uint64_t kSeedCount = 40;
constexpr std::size_t kBytes = 64;

#define CUDA_OK(call) ASSERT_EQ(call, cudaSuccess)

/// Two devices; a stream and memory on the first, and memory of the host. The next one forgets them.
struct Fixture {
    cudaStream_t stream = nullptr;
    unsigned *host = nullptr, *device = nullptr;

    explicit Fixture(std::uint64_t seed)
    {
        simt::resetMachine({4096, 1024}, seed);
        EXPECT_EQ(cudaStreamCreateWithFlags(&stream, cudaStreamNonBlocking), cudaSuccess);
        host = static_cast<unsigned*>(allocateHost(kBytes));
        device = static_cast<unsigned*>(allocate(kBytes));
    }

    static void* allocate(std::size_t bytes)
    {
        void* pointer = nullptr;
        EXPECT_EQ(cudaMalloc(&pointer, bytes), cudaSuccess);
        return pointer;
    }

    static void* allocateHost(std::size_t bytes, unsigned flags = cudaHostAllocDefault)
    {
        void* pointer = nullptr;
        EXPECT_EQ(cudaHostAlloc(&pointer, bytes, flags), cudaSuccess);
        return pointer;
    }

    static cudaEvent_t makeEvent(unsigned flags = cudaEventDefault)
    {
        cudaEvent_t event = nullptr;
        EXPECT_EQ(cudaEventCreateWithFlags(&event, flags), cudaSuccess);
        return event;
    }

    static cudaStream_t makeStream()
    {
        cudaStream_t made = nullptr;
        EXPECT_EQ(cudaStreamCreateWithFlags(&made, cudaStreamNonBlocking), cudaSuccess);
        return made;
    }
};

__global__ void storeKernel(unsigned* to, unsigned value)
{
    to[threadIdx.x] = value;
}

__global__ void addKernel(unsigned* to, const unsigned* from)
{
    to[threadIdx.x] += from[threadIdx.x];
}

__global__ void throwKernel()
{
    throw simt::Error("planted");
}

__global__ void barrierKernel(unsigned* to)
{
    if (threadIdx.x == 0) return;
    __syncthreads();
    *to = 1;
}

TEST(CudaRuntime, ListsTheDevices)
{
    simt::resetMachine({}, 1);
    int count = -1;
    EXPECT_EQ(cudaGetDeviceCount(&count), cudaErrorNoDevice);
    EXPECT_EQ(count, 0);
    void* pointer = nullptr;
    EXPECT_EQ(cudaMalloc(&pointer, 1), cudaErrorInvalidDevice);

    simt::resetMachine({1000, 2000}, 1);
    CUDA_OK(cudaGetDeviceCount(&count));
    EXPECT_EQ(count, 2);
    cudaDeviceProp first, second;
    CUDA_OK(cudaGetDeviceProperties(&first, 0));
    CUDA_OK(cudaGetDeviceProperties(&second, 1));
    EXPECT_EQ(first.totalGlobalMem, 1000u);
    EXPECT_EQ(second.totalGlobalMem, 2000u);
    EXPECT_NE(first.pciBusID, second.pciBusID);
    EXPECT_STREQ(first.name, "SIMT emulation");
    EXPECT_EQ(cudaGetDeviceProperties(&first, 2), cudaErrorInvalidDevice);
    EXPECT_EQ(cudaSetDevice(2), cudaErrorInvalidDevice);
    EXPECT_EQ(cudaSetDevice(-1), cudaErrorInvalidDevice);
    int version = 0;
    CUDA_OK(cudaDriverGetVersion(&version));
    EXPECT_GE(version, 11000);
    CUDA_OK(cudaRuntimeGetVersion(&version));
    EXPECT_GE(version, 11000);
}

TEST(CudaRuntime, EachThreadHasItsDevice)
{
    simt::resetMachine({1000, 2000}, 1);
    CUDA_OK(cudaSetDevice(1));
    int here = -1, there = -1;
    std::thread([&] { EXPECT_EQ(cudaGetDevice(&there), cudaSuccess); }).join();
    CUDA_OK(cudaGetDevice(&here));
    EXPECT_EQ(here, 1);
    EXPECT_EQ(there, 0);
}

TEST(CudaRuntime, MemoryIsCountedAndEnds)
{
    simt::resetMachine({1000, 2000}, 1);
    void *first = nullptr, *second = nullptr;
    CUDA_OK(cudaMalloc(&first, 600));
    EXPECT_EQ(cudaMalloc(&second, 401), cudaErrorMemoryAllocation);
    std::size_t freeBytes = 0, totalBytes = 0;
    CUDA_OK(cudaMemGetInfo(&freeBytes, &totalBytes));
    EXPECT_EQ(freeBytes, 400u);
    EXPECT_EQ(totalBytes, 1000u);
    CUDA_OK(cudaMalloc(&second, 400));
    CUDA_OK(cudaSetDevice(1));
    CUDA_OK(cudaMemGetInfo(&freeBytes, &totalBytes));
    EXPECT_EQ(freeBytes, 2000u);
    CUDA_OK(cudaFree(first)); // of another device than the current one
    CUDA_OK(cudaSetDevice(0));
    CUDA_OK(cudaMemGetInfo(&freeBytes, &totalBytes));
    EXPECT_EQ(freeBytes, 600u);
    EXPECT_EQ(cudaFree(first), cudaErrorInvalidValue);
    EXPECT_EQ(cudaFree(static_cast<char*>(second) + 4), cudaErrorInvalidValue);
    EXPECT_EQ(cudaFreeHost(second), cudaErrorInvalidValue);
    CUDA_OK(cudaFree(nullptr));
    CUDA_OK(cudaFreeHost(nullptr));
    CUDA_OK(cudaMalloc(&first, 0));
    EXPECT_EQ(first, nullptr);
    CUDA_OK(cudaHostAlloc(&first, 5000, cudaHostAllocPortable)); // the host's memory is not counted
    CUDA_OK(cudaMemGetInfo(&freeBytes, &totalBytes));
    EXPECT_EQ(freeBytes, 600u);
    EXPECT_EQ(cudaFree(first), cudaErrorInvalidValue);
    CUDA_OK(cudaFreeHost(first));
    CUDA_OK(cudaFree(second));
    EXPECT_EQ(simt::liveAllocations(), 0u);
}

TEST(CudaRuntime, MemoryStartsAsBytesOfTheSeed)
{
    std::vector<std::vector<unsigned>> seen;
    for (const std::uint64_t seed : {1u, 1u, 2u}) {
        const Fixture fixture(seed);
        seen.emplace_back(fixture.device, fixture.device + kBytes / 4);
    }
    EXPECT_EQ(seen[0], seen[1]);
    EXPECT_NE(seen[0], seen[2]);
}

TEST(CudaRuntime, OnlyMappedHostMemoryHasAnAddressOnTheDevice)
{
    const Fixture fixture(1);
    void *mapped = Fixture::allocateHost(8, cudaHostAllocMapped), *address = nullptr;
    CUDA_OK(cudaHostGetDevicePointer(&address, mapped, 0));
    EXPECT_EQ(address, mapped);
    EXPECT_EQ(cudaHostGetDevicePointer(&address, fixture.host, 0), cudaErrorInvalidValue);
    EXPECT_EQ(cudaHostGetDevicePointer(&address, fixture.device, 0), cudaErrorInvalidValue);
}

TEST(CudaRuntime, CopiesStayInsideOneLiveAllocation)
{
    const Fixture f(1);
    std::vector<char> pageable(kBytes);
    char* const host = reinterpret_cast<char*>(f.host);
    char* const device = reinterpret_cast<char*>(f.device);
    const auto copy = [&](void* to, const void* from, std::size_t bytes, cudaMemcpyKind kind) {
        return cudaMemcpyAsync(to, from, bytes, kind, f.stream);
    };
    CUDA_OK(copy(device, host, kBytes, cudaMemcpyHostToDevice));
    CUDA_OK(copy(host + 1, device + 1, kBytes - 1, cudaMemcpyDeviceToHost));
    CUDA_OK(copy(device, device + 32, 32, cudaMemcpyDeviceToDevice));
    CUDA_OK(copy(nullptr, nullptr, 0, cudaMemcpyHostToDevice));
    CUDA_OK(cudaMemsetAsync(device, 0, kBytes, f.stream));
    EXPECT_EQ(copy(device, host, kBytes + 1, cudaMemcpyHostToDevice), cudaErrorInvalidValue);
    EXPECT_EQ(copy(device + 1, host, kBytes, cudaMemcpyHostToDevice), cudaErrorInvalidValue);
    EXPECT_EQ(copy(device - 1, host, 1, cudaMemcpyHostToDevice), cudaErrorInvalidValue);
    EXPECT_EQ(copy(device + kBytes, host, 1, cudaMemcpyHostToDevice), cudaErrorInvalidValue);
    EXPECT_EQ(copy(device, host, kBytes, cudaMemcpyDeviceToHost), cudaErrorInvalidValue);
    EXPECT_EQ(copy(device, host, kBytes, cudaMemcpyDeviceToDevice), cudaErrorInvalidValue);
    EXPECT_EQ(copy(device, pageable.data(), kBytes, cudaMemcpyHostToDevice), cudaErrorInvalidValue);
    EXPECT_EQ(copy(pageable.data(), device, kBytes, cudaMemcpyDeviceToHost), cudaErrorInvalidValue);
    EXPECT_EQ(cudaMemsetAsync(device, 0, kBytes + 1, f.stream), cudaErrorInvalidValue);
    EXPECT_EQ(cudaMemsetAsync(host, 0, kBytes, f.stream), cudaErrorInvalidValue);
    EXPECT_EQ(cudaMemcpyAsync(device, host, 1, cudaMemcpyHostToDevice, nullptr),
              cudaErrorInvalidResourceHandle);
}

TEST(CudaRuntime, FreedMemoryIsSeenWhenTheCopyRuns)
{
    unsigned seenCount = 0;
    for (std::uint64_t seed = 0; seed < kSeedCount; ++seed) {
        const Fixture f(seed);
        CUDA_OK(cudaMemcpyAsync(f.device, f.host, kBytes, cudaMemcpyHostToDevice, f.stream));
        CUDA_OK(cudaFree(f.device));
        const cudaError_t code = cudaStreamSynchronize(f.stream);
        seenCount += code == cudaErrorIllegalAddress;
        EXPECT_TRUE(code == cudaSuccess || code == cudaErrorIllegalAddress);
    }
    EXPECT_GT(seenCount, 0u);
    EXPECT_LT(seenCount, kSeedCount);
}

void enqueueStoreAndFetch(const Fixture& f, unsigned value)
{
    CUDA_OK(cudaMemsetAsync(f.device, 0, kBytes, f.stream));
    simt::launchAsync(storeKernel, 1, kBytes / 4, 0, f.stream, f.device, value);
    CUDA_OK(cudaMemcpyAsync(f.host, f.device, kBytes, cudaMemcpyDeviceToHost, f.stream));
    CUDA_OK(cudaGetLastError());
}

TEST(CudaRuntime, AKernelIsLoadedWhenAskedForOrByItsFirstLaunch)
{
    const Fixture f(1);
    const auto freeBytes = [] {
        std::size_t free = 0, total = 0;
        EXPECT_EQ(cudaMemGetInfo(&free, &total), cudaSuccess);
        return free;
    };
    const std::size_t before = freeBytes();
    cudaFuncAttributes attributes;
    CUDA_OK(cudaFuncGetAttributes(&attributes, storeKernel));
    EXPECT_EQ(before - freeBytes(), simt::kKernelBytes);
    simt::launchAsync(storeKernel, 1, 1, 0, f.stream, f.device, 1u);
    EXPECT_EQ(simt::loadedKernels(), 1u);
    simt::launchAsync(addKernel, 1, 1, 0, f.stream, f.device, f.device);
    CUDA_OK(cudaStreamSynchronize(f.stream));
    EXPECT_EQ(simt::loadedKernels(), 2u);
    EXPECT_EQ(before - freeBytes(), 2 * simt::kKernelBytes);
    CUDA_OK(cudaSetDevice(1));
    CUDA_OK(cudaFuncGetAttributes(&attributes, storeKernel));
    EXPECT_EQ(simt::loadedKernels(), 3u) << "each device has its own";
}

TEST(CudaRuntime, AStreamRunsInOrderAndIsWaitedFor)
{
    for (std::uint64_t seed = 0; seed < kSeedCount; ++seed) {
        const Fixture f(seed);
        enqueueStoreAndFetch(f, 7);
        CUDA_OK(cudaStreamSynchronize(f.stream));
        EXPECT_EQ(std::vector<unsigned>(f.host, f.host + kBytes / 4), std::vector<unsigned>(kBytes / 4, 7));
    }
}

TEST(CudaRuntime, AResultReadTooEarlyIsWrongUnderSomeSeed)
{
    unsigned wrongCount = 0;
    for (std::uint64_t seed = 0; seed < kSeedCount; ++seed) {
        const Fixture f(seed);
        enqueueStoreAndFetch(f, 7);
        int device = 0;
        CUDA_OK(cudaGetDevice(&device)); // no synchronisation, but work may run
        wrongCount += f.host[0] != 7;
    }
    EXPECT_GT(wrongCount, 0u);
    EXPECT_LT(wrongCount, kSeedCount);
}

TEST(CudaRuntime, ASourceOverwrittenTooEarlyIsWrongUnderSomeSeed)
{
    unsigned wrongCount = 0;
    for (std::uint64_t seed = 0; seed < kSeedCount; ++seed) {
        const Fixture f(seed);
        std::fill_n(f.host, kBytes / 4, 7u);
        CUDA_OK(cudaMemcpyAsync(f.device, f.host, kBytes, cudaMemcpyHostToDevice, f.stream));
        int device = 0;
        CUDA_OK(cudaGetDevice(&device));
        std::fill_n(f.host, kBytes / 4, 8u);
        CUDA_OK(cudaStreamSynchronize(f.stream));
        wrongCount += f.device[0] != 7;
    }
    EXPECT_GT(wrongCount, 0u);
    EXPECT_LT(wrongCount, kSeedCount);
}

TEST(CudaRuntime, AnEventIsWaitedForWithWhatItWaitsForAndNoMore)
{
    unsigned laterCount = 0;
    for (std::uint64_t seed = 0; seed < kSeedCount; ++seed) {
        const Fixture f(seed);
        const cudaStream_t other = Fixture::makeStream();
        const cudaEvent_t stored = Fixture::makeEvent(), added = Fixture::makeEvent(cudaEventBlockingSync);
        unsigned* const sum = static_cast<unsigned*>(Fixture::allocate(kBytes));
        CUDA_OK(cudaMemsetAsync(sum, 0, kBytes, other));
        simt::launchAsync(storeKernel, 1, kBytes / 4, 0, f.stream, f.device, 5u);
        CUDA_OK(cudaEventRecord(stored, f.stream));
        CUDA_OK(cudaStreamWaitEvent(other, stored));
        simt::launchAsync(addKernel, 1, kBytes / 4, 0, other, sum, f.device);
        CUDA_OK(cudaEventRecord(added, other));
        simt::launchAsync(storeKernel, 1, kBytes / 4, 0, other, sum, 6u);
        CUDA_OK(cudaEventSynchronize(added));
        EXPECT_TRUE(sum[3] == 5 || sum[3] == 6) << sum[3];
        laterCount += sum[3] == 6;
        CUDA_OK(cudaDeviceSynchronize());
        EXPECT_EQ(sum[3], 6u);
    }
    EXPECT_LT(laterCount, kSeedCount / 2);
}

TEST(CudaRuntime, AForgottenWaitIsWrongUnderSomeSeed)
{
    unsigned wrongCount = 0;
    for (std::uint64_t seed = 0; seed < kSeedCount; ++seed) {
        const Fixture f(seed);
        const cudaStream_t other = Fixture::makeStream();
        simt::launchAsync(storeKernel, 1, kBytes / 4, 0, f.stream, f.device, 5u);
        CUDA_OK(cudaMemcpyAsync(f.host, f.device, kBytes, cudaMemcpyDeviceToHost, other));
        CUDA_OK(cudaStreamSynchronize(f.stream));
        CUDA_OK(cudaStreamSynchronize(other));
        wrongCount += f.host[0] != 5;
    }
    EXPECT_GT(wrongCount, 0u);
    EXPECT_LT(wrongCount, kSeedCount);
}

TEST(CudaRuntime, AWaitMeansTheRecordBeforeIt)
{
    for (std::uint64_t seed = 0; seed < kSeedCount; ++seed) {
        const Fixture f(seed);
        const cudaStream_t other = Fixture::makeStream();
        const cudaEvent_t event = Fixture::makeEvent();
        CUDA_OK(cudaStreamWaitEvent(other, event)); // nothing was recorded, so nothing is waited for
        CUDA_OK(cudaEventSynchronize(event));
        CUDA_OK(cudaEventQuery(event));
        simt::launchAsync(storeKernel, 1, 1, 0, f.stream, f.device, 1u);
        CUDA_OK(cudaEventRecord(event, f.stream));
        CUDA_OK(cudaStreamWaitEvent(other, event));
        CUDA_OK(cudaEventRecord(event, other)); // the second record does not change what `other` waits for
        CUDA_OK(cudaStreamSynchronize(other));
        EXPECT_EQ(f.device[0], 1u);
        CUDA_OK(cudaEventQuery(event));
    }
}

TEST(CudaRuntime, AnEventThatIsPolledComes)
{
    unsigned waitedCount = 0;
    for (std::uint64_t seed = 0; seed < kSeedCount; ++seed) {
        const Fixture f(seed);
        const cudaEvent_t event = Fixture::makeEvent(cudaEventDisableTiming);
        enqueueStoreAndFetch(f, 9);
        CUDA_OK(cudaEventRecord(event, f.stream));
        bool hasWaited = false;
        while (cudaEventQuery(event) == cudaErrorNotReady) hasWaited = true;
        EXPECT_EQ(f.host[0], 9u);
        waitedCount += hasWaited;
    }
    EXPECT_GT(waitedCount, 0u);
}

TEST(CudaRuntime, TimesAreOfTheWorkBetween)
{
    const Fixture f(3);
    const cudaEvent_t start = Fixture::makeEvent(), end = Fixture::makeEvent();
    const cudaEvent_t untimed = Fixture::makeEvent(cudaEventDisableTiming);
    float milliseconds = 0;
    EXPECT_EQ(cudaEventElapsedTime(&milliseconds, start, end), cudaErrorInvalidResourceHandle);
    EXPECT_EQ(cudaGetLastError(), cudaErrorInvalidResourceHandle);
    CUDA_OK(cudaEventRecord(start, f.stream));
    enqueueStoreAndFetch(f, 1);
    CUDA_OK(cudaEventRecord(end, f.stream));
    CUDA_OK(cudaEventRecord(untimed, f.stream));
    CUDA_OK(cudaStreamSynchronize(f.stream));
    CUDA_OK(cudaEventElapsedTime(&milliseconds, start, end));
    EXPECT_FLOAT_EQ(milliseconds, 0.004f); // three pieces of work and the record itself
    EXPECT_EQ(cudaEventElapsedTime(&milliseconds, start, untimed), cudaErrorInvalidResourceHandle);
}

TEST(CudaRuntime, HandlesEndAndBelongToADevice)
{
    const Fixture f(1);
    const cudaEvent_t event = Fixture::makeEvent();
    CUDA_OK(cudaSetDevice(1));
    const cudaEvent_t foreign = Fixture::makeEvent();
    EXPECT_EQ(cudaEventRecord(foreign, f.stream), cudaErrorInvalidResourceHandle);
    EXPECT_EQ(cudaGetLastError(), cudaErrorInvalidResourceHandle);
    simt::launchAsync(storeKernel, 1, 1, 0, f.stream, f.device, 1u); // the stream is of device 0
    EXPECT_EQ(cudaGetLastError(), cudaErrorInvalidResourceHandle);
    CUDA_OK(cudaEventDestroy(event));
    CUDA_OK(cudaEventDestroy(foreign));
    EXPECT_EQ(cudaEventDestroy(event), cudaErrorInvalidResourceHandle);
    EXPECT_EQ(cudaEventQuery(event), cudaErrorInvalidResourceHandle);
    CUDA_OK(cudaStreamDestroy(f.stream));
    EXPECT_EQ(cudaStreamSynchronize(f.stream), cudaErrorInvalidResourceHandle);
    EXPECT_EQ(cudaEventRecord(event, nullptr), cudaErrorInvalidResourceHandle);
    EXPECT_EQ(simt::liveAllocations(), 2u);
}

TEST(CudaRuntime, WorkOutlivesItsStream)
{
    for (std::uint64_t seed = 0; seed < kSeedCount; ++seed) {
        const Fixture f(seed);
        enqueueStoreAndFetch(f, 7);
        CUDA_OK(cudaStreamDestroy(f.stream));
        CUDA_OK(cudaDeviceSynchronize());
        EXPECT_EQ(f.host[0], 7u);
    }
}

TEST(CudaRuntime, ADeviceIsSynchronisedAlone)
{
    unsigned lateCount = 0;
    for (std::uint64_t seed = 0; seed < kSeedCount; ++seed) {
        const Fixture f(seed);
        enqueueStoreAndFetch(f, 7);
        CUDA_OK(cudaSetDevice(1));
        CUDA_OK(cudaDeviceSynchronize());
        lateCount += f.host[0] != 7;
        CUDA_OK(cudaSetDevice(0));
        CUDA_OK(cudaDeviceSynchronize());
        EXPECT_EQ(f.host[0], 7u);
    }
    EXPECT_GT(lateCount, 0u);
}

TEST(CudaRuntime, WhatAKernelThrowsLeavesFromASynchronisation)
{
    for (std::uint64_t seed = 0; seed < kSeedCount; ++seed) {
        const Fixture f(seed);
        const cudaStream_t other = Fixture::makeStream();
        const cudaEvent_t event = Fixture::makeEvent();
        f.host[0] = 1;
        CUDA_OK(cudaMemsetAsync(f.device, 0, kBytes, f.stream));
        simt::launchAsync(throwKernel, 1, 1, 0, f.stream);
        CUDA_OK(cudaMemcpyAsync(f.host, f.device, kBytes, cudaMemcpyDeviceToHost, f.stream));
        CUDA_OK(cudaEventRecord(event, f.stream));
        CUDA_OK(cudaStreamWaitEvent(other, event));
        try {
            static_cast<void>(seed % 2 ? cudaStreamSynchronize(other) : cudaEventSynchronize(event));
            ADD_FAILURE() << "nothing was thrown";
        } catch (const simt::Error& error) {
            EXPECT_STREQ(error.what(), "planted");
        }
        // Once only, so that owners can clean up; and nobody waits for ever for what will not run.
        CUDA_OK(cudaDeviceSynchronize());
        CUDA_OK(cudaEventQuery(event));
        EXPECT_EQ(f.host[0], 1u);
    }
    const Fixture f(1);
    simt::launchAsync(barrierKernel, 1, 2, 0, f.stream, f.device);
    EXPECT_THROW(cudaStreamSynchronize(f.stream), simt::Error);
}

TEST(CudaRuntime, AnArgumentIsCopiedAtTheLaunch)
{
    const Fixture f(2);
    unsigned value = 3;
    simt::launchAsync(storeKernel, 1, 1, 0, f.stream, f.device, value);
    value = 4;
    CUDA_OK(cudaStreamSynchronize(f.stream));
    EXPECT_EQ(f.device[0], 3u);
}

TEST(CudaRuntime, FailsWhenAsked)
{
    const Fixture f(1);
    void* pointer = nullptr;
    simt::fail("cudaMalloc", 2, cudaErrorLaunchFailure);
    CUDA_OK(cudaMalloc(&pointer, 1));
    CUDA_OK(cudaMalloc(&pointer, 1));
    const std::size_t before = simt::liveAllocations();
    EXPECT_EQ(cudaMalloc(&pointer, 1), cudaErrorLaunchFailure);
    EXPECT_EQ(simt::liveAllocations(), before);
    CUDA_OK(cudaMalloc(&pointer, 1));

    EXPECT_EQ(cudaPeekAtLastError(), cudaErrorLaunchFailure);
    EXPECT_EQ(cudaGetLastError(), cudaErrorLaunchFailure);
    EXPECT_EQ(cudaGetLastError(), cudaSuccess);
    EXPECT_STREQ(cudaGetErrorName(cudaErrorLaunchFailure), "cudaErrorLaunchFailure");
    EXPECT_NE(std::string(cudaGetErrorString(cudaErrorLaunchFailure)), "");

    f.device[0] = 1;
    simt::fail("launch", 0, cudaErrorLaunchFailure);
    simt::launchAsync(storeKernel, 1, 1, 0, f.stream, f.device, 2u);
    EXPECT_EQ(cudaGetLastError(), cudaErrorLaunchFailure);
    CUDA_OK(cudaDeviceSynchronize());
    EXPECT_EQ(f.device[0], 1u);
}

// Each thread has its stream and memory, as the buffers of the device layer have.
TEST(CudaRuntime, ServesManyThreads)
{
    simt::resetMachine({1 << 16}, 5);
    std::vector<std::thread> threads;
    for (unsigned id = 1; id <= 4; ++id)
        threads.emplace_back([id] {
            const cudaStream_t stream = Fixture::makeStream();
            const cudaEvent_t event = Fixture::makeEvent();
            for (unsigned round = 0; round < 50; ++round) {
                unsigned* const host = static_cast<unsigned*>(Fixture::allocateHost(kBytes));
                unsigned* const device = static_cast<unsigned*>(Fixture::allocate(kBytes));
                simt::launchAsync(storeKernel, 1, kBytes / 4, 0, stream, device, id * 100 + round);
                EXPECT_EQ(cudaMemcpyAsync(host, device, kBytes, cudaMemcpyDeviceToHost, stream), cudaSuccess);
                EXPECT_EQ(cudaEventRecord(event, stream), cudaSuccess);
                EXPECT_EQ(cudaEventSynchronize(event), cudaSuccess);
                EXPECT_EQ(std::count(host, host + kBytes / 4, id * 100 + round), kBytes / 4);
                EXPECT_EQ(cudaFree(device), cudaSuccess);
                EXPECT_EQ(cudaFreeHost(host), cudaSuccess);
            }
            EXPECT_EQ(cudaEventDestroy(event), cudaSuccess);
            EXPECT_EQ(cudaStreamDestroy(stream), cudaSuccess);
        });
    for (std::thread& thread : threads) thread.join();
    EXPECT_EQ(simt::liveAllocations(), 0u);
}

#if defined(SIMT_ASAN)
TEST(CudaRuntimeDeathTest, AKernelMayNotWritePastAnAllocation)
{
    const Fixture f(1);
    const auto overrun = [&] {
        simt::launchAsync(storeKernel, 1, kBytes / 4 + 1, 0, f.stream, f.device, 1u);
        static_cast<void>(cudaStreamSynchronize(f.stream));
    };
    EXPECT_DEATH(overrun(), "heap-buffer-overflow");
}
#endif

} // namespace

} // namespace vdb_nns::testing

// CUDA's runtime API as a fake, for host code that is to run without a GPU: who links vdb_nns_simt finds it
// in place of CUDA's own header. Names, signatures and codes are CUDA's; what is not used is left out.
//
// A stream is a queue. Nothing in it runs at the call, but at a synchronisation that needs it, on that
// thread, or at some other call, as the seed has it: over seeds work runs late and early, and who reads a
// result before waiting for it gets wrong bytes. One piece of work runs at a time and takes 0.001 ms. What it
// throws leaves, once, from a later synchronisation, of whichever stream; nothing runs after it until
// resetMachine().
//
// Stricter than the hardware: there is no default stream; the host's side of a copy must be cudaHostAlloc's
// (pageable memory makes the real copy synchronous, which this project forbids), and copies from host to host
// do not compile; cudaFree does not wait for work that uses the memory; memory starts as random bytes; only
// cudaHostAllocMapped memory has an address on the device.
#pragma once

#include "simt/simt.h"

#include <vector>

#define SIMT_CUDA_ERRORS(X)                                                                                  \
    X(cudaSuccess, 0), X(cudaErrorInvalidValue, 1), X(cudaErrorMemoryAllocation, 2),                         \
        X(cudaErrorNoDevice, 100), X(cudaErrorInvalidDevice, 101), X(cudaErrorInvalidResourceHandle, 400),   \
        X(cudaErrorNotReady, 600), X(cudaErrorIllegalAddress, 700), X(cudaErrorLaunchFailure, 719)
#define SIMT_ENUMERATOR(name, code) name = code
enum cudaError_t { SIMT_CUDA_ERRORS(SIMT_ENUMERATOR) };
#undef SIMT_ENUMERATOR

enum cudaMemcpyKind { cudaMemcpyHostToDevice = 1, cudaMemcpyDeviceToHost = 2, cudaMemcpyDeviceToDevice = 3 };
constexpr unsigned cudaHostAllocDefault = 0, cudaHostAllocPortable = 1, cudaHostAllocMapped = 2;
constexpr unsigned cudaEventDefault = 0, cudaEventBlockingSync = 1, cudaEventDisableTiming = 2;
constexpr unsigned cudaStreamNonBlocking = 1;

using cudaStream_t = struct CUstream_st*;
using cudaEvent_t = struct CUevent_st*;

struct cudaDeviceProp {
    char name[256];
    size_t totalGlobalMem;
    int major, minor, multiProcessorCount, pciDomainID, pciBusID, pciDeviceID;
};

cudaError_t cudaGetDeviceCount(int*), cudaSetDevice(int), cudaGetDevice(int*);
cudaError_t cudaGetDeviceProperties(cudaDeviceProp*, int device);
struct cudaFuncAttributes {
    size_t localSizeBytes;
};
cudaError_t cudaFuncGetAttributes(cudaFuncAttributes*, const void* kernel);
template <class... Parameters>
cudaError_t cudaFuncGetAttributes(cudaFuncAttributes* all, void (*kernel)(Parameters...))
{
    return cudaFuncGetAttributes(all, reinterpret_cast<const void*>(kernel));
}
cudaError_t cudaDriverGetVersion(int*), cudaRuntimeGetVersion(int*);
cudaError_t cudaGetLastError(), cudaPeekAtLastError();
const char* cudaGetErrorName(cudaError_t);
const char* cudaGetErrorString(cudaError_t);
cudaError_t cudaMemGetInfo(size_t* freeBytes, size_t* totalBytes);
cudaError_t cudaMalloc(void**, size_t), cudaFree(void*);
cudaError_t cudaHostAlloc(void**, size_t, unsigned flags), cudaFreeHost(void*);
cudaError_t cudaHostGetDevicePointer(void** onDevice, void* onHost, unsigned flags);
cudaError_t cudaStreamCreateWithFlags(cudaStream_t*, unsigned flags), cudaStreamDestroy(cudaStream_t);
cudaError_t cudaStreamSynchronize(cudaStream_t), cudaDeviceSynchronize();
cudaError_t cudaStreamWaitEvent(cudaStream_t, cudaEvent_t, unsigned flags = 0);
cudaError_t cudaEventCreateWithFlags(cudaEvent_t*, unsigned flags), cudaEventDestroy(cudaEvent_t);
cudaError_t cudaEventRecord(cudaEvent_t, cudaStream_t);
cudaError_t cudaEventSynchronize(cudaEvent_t), cudaEventQuery(cudaEvent_t);
cudaError_t cudaEventElapsedTime(float* milliseconds, cudaEvent_t start, cudaEvent_t end);
cudaError_t cudaMemcpyAsync(void* to, const void* from, size_t bytes, cudaMemcpyKind, cudaStream_t);
cudaError_t cudaMemsetAsync(void* to, int value, size_t bytes, cudaStream_t);

namespace simt {

/// Starts anew: forgets streams, events, memory and planned failures. At first there is no device.
void resetMachine(const std::vector<std::size_t>& bytesOfEachDevice, std::uint64_t seed);

/// After `afterCalls` more calls of that name, by any thread, one returns the code and does nothing else.
/// The name of launchAsync() is "launch".
void fail(const char* callName, int afterCalls, cudaError_t code);

/// Allocations on devices and host, streams and events that nobody has freed or destroyed.
std::size_t liveAllocations();

/// Kernels that are in a device's memory, over all devices: each is loaded when its attributes are asked for, or else by its first
/// launch, and takes kKernelBytes.
std::size_t loadedKernels();
constexpr std::size_t kKernelBytes = 16;

void enqueueLaunch(const void* kernel, cudaStream_t stream,
                   const std::function<void(std::uint64_t seed)>& run);

/// Stands for `kernel<<<grid, block, sharedBytes, stream>>>(args...)`: cudaGetLastError() tells of errors.
template <class... Parameters, class... Arguments>
void launchAsync(void (*kernel)(Parameters...), dim3 grid, dim3 block, std::size_t sharedBytes,
                 cudaStream_t stream, Arguments... args)
{
    enqueueLaunch(reinterpret_cast<const void*>(kernel), stream,
                  [=](std::uint64_t seed) { launch(kernel, grid, block, sharedBytes, seed, args...); });
}

} // namespace simt

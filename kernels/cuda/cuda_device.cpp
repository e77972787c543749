// BlockDevice on a CUDA device: one stream for each buffer, so that blocks of different buffers upload, search and download at
// the same time; memory is taken once and counted to the byte; events are the only thing that is waited for. The mapped
// variant, a baseline, keeps blocks in pinned host memory that kernels read and write through the link.
#include "cuda/cuda_check.h"
#include "cuda/launch.h"
#include "cuda/search_block.h"

#include <algorithm>
#include <array>
#include <iterator>
#include <memory>
#include <mutex>
#include <utility>
#include <vector>

namespace vdb_nns::cuda {

namespace {

// Left to the driver and to other programs of the device.
constexpr std::uint64_t kReserveBytes = std::uint64_t(64) << 20;

enum Step { kUpload, kSearch, kDownload, kSteps };

class CudaDevice final : public BlockDevice {
public:
    explicit CudaDevice(const OpenOptions& options) : mOptions(options)
    {
        select();
        loadKernels();
        try {
            mQueues.resize(static_cast<std::size_t>(options.buffers));
            for (Queue& queue : mQueues) {
                VDB_NNS_CUDA_CHECK(cudaStreamCreateWithFlags(&queue.stream, cudaStreamNonBlocking));
                for (Interval& interval : queue.intervals) {
                    VDB_NNS_CUDA_CHECK(cudaEventCreateWithFlags(&interval.begin, cudaEventBlockingSync));
                    VDB_NNS_CUDA_CHECK(cudaEventCreateWithFlags(&interval.end, cudaEventBlockingSync));
                }
            }
            VDB_NNS_CUDA_CHECK(cudaEventCreateWithFlags(&mOpened, cudaEventDefault));
            startClock();
        } catch (...) {
            close();
            throw;
        }
    }

    ~CudaDevice() override { close(); }
    CudaDevice(const CudaDevice&) = delete;
    CudaDevice& operator=(const CudaDevice&) = delete;

    bool isSimulated() const override { return false; }

    std::byte* allocate(std::uint64_t bytes) override
    {
        select();
        const Piece piece = take(mMemory, bytes, mOptions.budgetBytes - mUsedBytes, [&] {
            requireBudget(bytes);
            if (mOptions.mapped) return pinnedMemory(bytes);
            void* memory = nullptr;
            checkMemory(cudaMalloc(&memory, bytes), "cudaMalloc", bytes);
            return static_cast<std::byte*>(memory);
        });
        mUsedBytes += piece.bytes;
        std::uint64_t held = 0;
        for (const Piece& p : mMemory) held += p.bytes;
        mPeakBytes = std::max(mPeakBytes, held);
        mHandedOut.push_back(piece.memory);
        return piece.memory;
    }

    std::byte* allocateStaging(std::uint64_t bytes) override
    {
        select();
        // A mapped block is written where it stays.
        if (mOptions.mapped) return mHandedOut.at(mMappedStagings++);
        return take(mStaging, bytes, ~std::uint64_t(0), [&] { return pinnedMemory(bytes); }).memory;
    }

    void releaseAll() override
    {
        handBack();
        dropFree(mMemory);
        dropFree(mStaging);
    }

    void restart() override
    {
        handBack();
        mPeakBytes = 0;
        startClock();
    }

    void upload(int buffer, std::byte* device, const std::byte* staging, std::uint64_t bytes) override
    {
        if (device == staging) return;
        run(buffer, kUpload, [&](cudaStream_t stream) {
            VDB_NNS_CUDA_CHECK(cudaMemcpyAsync(device, staging, bytes, cudaMemcpyHostToDevice, stream));
        });
    }

    void search(int buffer, const BlockSearch& block) override
    {
        run(buffer, kSearch, [&](cudaStream_t stream) { launchSearchAsync(block, stream); });
    }

    std::byte* download(int buffer, std::byte* staging, std::byte* device, std::uint64_t bytes) override
    {
        if (mOptions.mapped) return device;
        run(buffer, kDownload, [&](cudaStream_t stream) {
            VDB_NNS_CUDA_CHECK(cudaMemcpyAsync(staging, device, bytes, cudaMemcpyDeviceToHost, stream));
        });
        return staging;
    }

    StepTimes wait(int number) override
    {
        select();
        Queue& queue = mQueues.at(static_cast<std::size_t>(number));
        StepTimes times;
        double* const seconds[kSteps] = {&times.uploadSeconds, &times.searchSeconds, &times.downloadSeconds};
        const std::size_t used = std::exchange(queue.used, 0);
        if (used > 0) VDB_NNS_CUDA_CHECK(cudaEventSynchronize(queue.intervals[used - 1].end));
        // A queue's interval begins when its stream comes to it, and includes waiting for other queues. What they have
        // been counted for is not counted again.
        const std::lock_guard<std::mutex> lock(mMutex);
        for (std::size_t i = 0; i < used; ++i) {
            const Interval& interval = queue.intervals[i];
            float begin = 0, end = 0;
            VDB_NNS_CUDA_CHECK(cudaEventElapsedTime(&begin, mOpened, interval.begin));
            VDB_NNS_CUDA_CHECK(cudaEventElapsedTime(&end, mOpened, interval.end));
            float& counted = mCounted[interval.step];
            *seconds[interval.step] +=
                1e-3 * static_cast<double>(std::max(0.0f, end - std::max(begin, counted)));
            counted = std::max(counted, end);
        }
        return times;
    }

    std::uint64_t peakBytes() const override { return mPeakBytes; }

private:
    struct Interval {
        cudaEvent_t begin = nullptr, end = nullptr;
        Step step = kUpload;
    };
    struct Queue {
        cudaStream_t stream = nullptr;
        std::array<Interval, 4> intervals; // as many steps as are taken between two waits
        std::size_t used = 0;
    };

    struct Piece {
        std::byte* memory;
        std::uint64_t bytes;
        bool isTaken;
    };

    // Every thread that calls CUDA says for which device.
    void select() const { VDB_NNS_CUDA_CHECK(cudaSetDevice(mOptions.ordinal)); }

    // Times are counted from here: floats of milliseconds do not stay fine for long. The event is complete before any other queue
    // is waited for, which knows only its own.
    void startClock()
    {
        VDB_NNS_CUDA_CHECK(cudaEventRecord(mOpened, mQueues.at(0).stream));
        VDB_NNS_CUDA_CHECK(cudaEventSynchronize(mOpened));
        std::fill(std::begin(mCounted), std::end(mCounted), 0.0f);
    }

    template <typename Enqueue>
    void run(int number, Step step, Enqueue&& enqueue)
    {
        select();
        Queue& queue = mQueues.at(static_cast<std::size_t>(number));
        Interval& interval = queue.intervals.at(queue.used);
        interval.step = step;
        VDB_NNS_CUDA_CHECK(cudaEventRecord(interval.begin, queue.stream));
        enqueue(queue.stream);
        VDB_NNS_CUDA_CHECK(cudaEventRecord(interval.end, queue.stream));
        ++queue.used;
    }

    void requireBudget(std::uint64_t bytes) const
    {
        std::uint64_t allowed = mOptions.budgetBytes - mUsedBytes;
        if (!mOptions.mapped) {
            std::size_t free = 0, total = 0;
            VDB_NNS_CUDA_CHECK(cudaMemGetInfo(&free, &total));
            allowed = std::min<std::uint64_t>(allowed, free - std::min<std::uint64_t>(free, kReserveBytes));
        }
        if (bytes <= allowed) return;
        throw OutOfDeviceMemory(mOptions.name + ": " + std::to_string(bytes) + " bytes do not fit beside " +
                                std::to_string(mUsedBytes) + " of a budget of " +
                                std::to_string(mOptions.budgetBytes) + ", " + std::to_string(allowed) +
                                " of it free");
    }

    void checkMemory(cudaError_t code, const char* call, std::uint64_t bytes) const
    {
        if (code == cudaSuccess) return;
        cudaGetLastError(); // it is told, so that the next call does not tell it again
        const std::string what = std::string(call) + " of " + std::to_string(bytes) + " bytes";
        if (code != cudaErrorMemoryAllocation) checkCall(code, what.c_str(), __FILE__, __LINE__);
        throw OutOfDeviceMemory(mOptions.name + ": " + what + ": " + cudaGetErrorString(code));
    }

    std::byte* pinnedMemory(std::uint64_t bytes) const
    {
        void* memory = nullptr;
        checkMemory(
            cudaHostAlloc(&memory, bytes, mOptions.mapped ? cudaHostAllocMapped : cudaHostAllocDefault),
            "cudaHostAlloc", bytes);
        return static_cast<std::byte*>(memory);
    }

    // A free piece that is large enough and not larger than `most`; else a new one, for which all free ones make room.
    template <typename Make>
    Piece take(std::vector<Piece>& pieces, std::uint64_t bytes, std::uint64_t most, Make&& make)
    {
        // Not one that is far too large: others would have to do with less.
        const std::uint64_t largest = std::min(most, bytes + bytes / 4);
        const auto fits = [&](const Piece& p) {
            return !p.isTaken && p.bytes >= bytes && p.bytes <= largest;
        };
        auto found = std::find_if(pieces.begin(), pieces.end(), fits);
        if (found == pieces.end()) {
            dropFree(pieces);
            std::byte* const memory = make();
            found = pieces.insert(pieces.end(), {memory, bytes, false});
        }
        found->isTaken = true;
        return *found;
    }

    // Nothing here throws: what fails while memory is given back has failed before, and was told.
    void handBack()
    {
        cudaSetDevice(mOptions.ordinal);
        for (Queue& queue : mQueues) {
            if (queue.stream) cudaStreamSynchronize(queue.stream);
            queue.used = 0;
        }
        for (std::vector<Piece>* pieces : {&mMemory, &mStaging}) {
            for (Piece& piece : *pieces) piece.isTaken = false;
        }
        mHandedOut.clear();
        mMappedStagings = 0;
        mUsedBytes = 0;
    }

    void dropFree(std::vector<Piece>& pieces)
    {
        const bool onHost = mOptions.mapped || &pieces == &mStaging;
        const auto taken =
            std::stable_partition(pieces.begin(), pieces.end(), [](const Piece& p) { return p.isTaken; });
        for (auto piece = taken; piece != pieces.end(); ++piece) {
            onHost ? cudaFreeHost(piece->memory) : cudaFree(piece->memory);
        }
        pieces.erase(taken, pieces.end());
    }

    void close()
    {
        releaseAll();
        for (Queue& queue : mQueues) {
            for (Interval& interval : queue.intervals) {
                if (interval.begin) cudaEventDestroy(interval.begin);
                if (interval.end) cudaEventDestroy(interval.end);
            }
            if (queue.stream) cudaStreamDestroy(queue.stream);
        }
        if (mOpened) cudaEventDestroy(mOpened);
    }

    const OpenOptions mOptions;
    std::vector<Queue> mQueues;
    std::vector<Piece> mMemory, mStaging;
    std::vector<std::byte*> mHandedOut; // of the memory, in the order in which it was asked for
    std::size_t mMappedStagings = 0;    // handed out
    std::uint64_t mUsedBytes = 0, mPeakBytes = 0;
    cudaEvent_t mOpened = nullptr;
    std::mutex mMutex;
    float mCounted[kSteps] = {}; // milliseconds since it was opened, to which each step is counted
};

} // namespace

std::unique_ptr<BlockDevice> openBlockDevice(const OpenOptions& options)
{
    return std::make_unique<CudaDevice>(options);
}

// The runtime is linked statically and opens the driver at its first call, so a program with this inside starts on machines
// that have none.
std::vector<Device> listDevices()
{
    int count = 0, driver = 0;
    if (cudaDriverGetVersion(&driver) == cudaSuccess && driver == 0) {
        throw DeviceError("CUDA: there is no NVIDIA driver on this machine");
    }
    VDB_NNS_CUDA_CHECK(cudaGetDeviceCount(&count));
    std::vector<Device> devices;
    for (int ordinal = 0; ordinal < count; ++ordinal) {
        cudaDeviceProp properties;
        VDB_NNS_CUDA_CHECK(cudaGetDeviceProperties(&properties, ordinal));
        devices.push_back({ordinal, properties.name, properties.totalGlobalMem, properties.major,
                           properties.minor, properties.multiProcessorCount});
    }
    return devices;
}

std::uint64_t freeBytes(int ordinal)
{
    VDB_NNS_CUDA_CHECK(cudaSetDevice(ordinal));
    loadKernels();
    std::size_t free = 0, total = 0;
    VDB_NNS_CUDA_CHECK(cudaMemGetInfo(&free, &total));
    return free - std::min<std::uint64_t>(free, kReserveBytes);
}

} // namespace vdb_nns::cuda

#include "bench/methods.h"

#include "machine.h"
#include "vdb_nns/error.h"

#include <algorithm>
#include <sstream>

namespace vdb_nns::cli {
namespace {

struct Family {
    const char* name;
    MethodPlace place;
    BoundaryMode boundary;
    int blockLog2Cells;
};
constexpr Family kFamilies[] = {
    {"ours", MethodPlace::kCpu, BoundaryMode::kHalo, 0},
    {"in-core", MethodPlace::kInCore, BoundaryMode::kHalo, 0},
    {"mapped", MethodPlace::kMapped, BoundaryMode::kHalo, 0},
    {"blocks", MethodPlace::kBlocks, BoundaryMode::kHalo, 0},
    {"blocks16", MethodPlace::kBlocks, BoundaryMode::kHalo, 4},
    {"blocks32", MethodPlace::kBlocks, BoundaryMode::kHalo, 5},
    {"blocks64", MethodPlace::kBlocks, BoundaryMode::kHalo, 6},
    {"both-cpu", MethodPlace::kCpuAndDevice, BoundaryMode::kCpu, 0},
    {"both-halo", MethodPlace::kCpuAndDevice, BoundaryMode::kHalo, 0},
    {"both-auto", MethodPlace::kCpuAndDevice, BoundaryMode::kAuto, 0},
};

struct EncodingName {
    const char* name;
    Encoding encoding;
};
constexpr EncodingName kEncodings[] = {
    {"index", Encoding::kIndex}, {"mask", Encoding::kMask}, {"count", Encoding::kNone}};

MethodSpec specOf(const Family& family, const EncodingName& encoding)
{
    return {std::string(family.name) + "-" + encoding.name, family.place, encoding.encoding, family.boundary,
            family.blockLog2Cells};
}

class CpuMethod : public Method {
public:
    explicit CpuMethod(const SearchOptions& options) : mOptions(options) {}

    MethodRun run(const ParticleView& view, double radius, const ProgressSpan& span) override
    {
        discard();
        span.printer.begin("search", span.begin, span.end);
        MethodRun result;
        const Stopwatch gridWatch;
        const SparseGrid grid = mEngine.buildGrid(view, radius, mOptions);
        result.gridSeconds = gridWatch.seconds();
        const Stopwatch searchWatch;
        mLists = mEngine.search(grid, mOptions);
        result.searchSeconds = searchWatch.seconds();
        result.pairs = mLists.pairCount();
        result.structureBytes = grid.bytes();
        result.listBytes = mLists.bytes();
        return result;
    }

private:
    SearchOptions mOptions;
    SearchEngine mEngine;
};

std::vector<MethodSpec> defaultMethods(const std::string& device)
{
    const bool isCuda = device.compare(0, 4, "cuda") == 0;
    std::vector<MethodSpec> specs;
    for (const Family& family : kFamilies) {
        for (const EncodingName& encoding : kEncodings) {
            const MethodSpec spec = specOf(family, encoding);
            if (spec.onDevice() && (device.empty() || encoding.encoding == Encoding::kNone)) continue;
            if (spec.place == MethodPlace::kMapped && !isCuda) continue;
            specs.push_back(spec);
        }
    }
    return specs;
}

} // namespace

std::string methodHelp()
{
    return "methods, separated by commas: FAMILY-index, FAMILY-mask or FAMILY-count, where FAMILY is ours "
           "(the CPU), "
           "in-core (a device, everything in its memory), mapped (a CUDA device that reads and writes host "
           "memory), "
           "blocks (devices, the largest blocks that fit --device-memory), blocks16, blocks32, blocks64 "
           "(blocks of 16^3, "
           "32^3, 64^3 cells), both-cpu, both-halo or both-auto (CPU and devices, by who runs the boundary); "
           "default: ours, and the others too where --device names a device";
}

MethodSpec parseMethod(const std::string& name)
{
    for (const Family& family : kFamilies) {
        for (const EncodingName& encoding : kEncodings) {
            MethodSpec spec = specOf(family, encoding);
            if (spec.name == name) return spec;
        }
    }
    std::string known;
    for (const Family& family : kFamilies) known += (known.empty() ? "" : ", ") + std::string(family.name);
    throw InvalidInput("--method: '" + name + "' is not known; use one of " + known +
                       ", with -index, -mask or -count, e.g. ours-mask");
}

std::vector<MethodSpec> parseMethods(const std::string& list, const std::string& device)
{
    if (list.empty()) return defaultMethods(device);
    std::vector<MethodSpec> specs;
    std::istringstream parts(list);
    for (std::string name; std::getline(parts, name, ',');) {
        const MethodSpec spec = parseMethod(name);
        const bool isThere = std::any_of(specs.begin(), specs.end(),
                                         [&](const MethodSpec& other) { return other.name == name; });
        if (!isThere) specs.push_back(spec);
    }
    return specs;
}

std::unique_ptr<Method> makeCpuMethod(const MethodSpec& spec, const SearchOptions& options)
{
    SearchOptions own = options;
    own.encoding = spec.encoding;
    return std::make_unique<CpuMethod>(own);
}

} // namespace vdb_nns::cli

#include "bench/method_names.h"

#include "bench/methods/engine_methods.h"
#include "bench/methods/other_methods.h"
#include "threads.h"
#include "vdb_nns/error.h"

#include <algorithm>
#include <charconv>
#include <sstream>

namespace vdb_nns::cli {
namespace {

struct EncodingName {
    const char* name;
    Encoding encoding;
};
constexpr EncodingName kEncodings[] = {
    {"index", Encoding::kIndex}, {"mask", Encoding::kMask}, {"count", Encoding::kNone}};

struct Family {
    const char* name;
    MethodPlace place = MethodPlace::kCpu;
    BoundaryMode boundary = BoundaryMode::kHalo;
    int blockLog2Cells = 0;
};
// Of the engine on devices: FAMILY-ENCODING. In the order of the help.
constexpr Family kDeviceFamilies[] = {
    {"in-core", MethodPlace::kInCore},
    {"mapped", MethodPlace::kMapped},
    {"blocks", MethodPlace::kBlocks},
    {"blocks16", MethodPlace::kBlocks, BoundaryMode::kHalo, 4},
    {"blocks32", MethodPlace::kBlocks, BoundaryMode::kHalo, 5},
    {"blocks64", MethodPlace::kBlocks, BoundaryMode::kHalo, 6},
    {"both-cpu", MethodPlace::kCpuAndDevice, BoundaryMode::kCpu},
    {"both-halo", MethodPlace::kCpuAndDevice, BoundaryMode::kHalo},
    {"both-auto", MethodPlace::kCpuAndDevice, BoundaryMode::kAuto},
};

// One name each; those of kApproximate are followed by a number. The numbers are those that the groups have.
struct Single {
    const char* name;
    MethodKind kind;
    std::vector<int> numbers;
};
const std::vector<Single>& singles()
{
    static const std::vector<Single> list = {
        {"certified", MethodKind::kAblation, {}},
        {"filter-only", MethodKind::kAblation, {}},
        {"world-float", MethodKind::kAblation, {}},
        {"world-double", MethodKind::kAblation, {}},
        {"codec16", MethodKind::kAblation, {}},
        {"codec8", MethodKind::kAblation, {}},
        {"sampled", MethodKind::kApproximate, {50, 10}},
        {"nearest", MethodKind::kApproximate, {32, 16}},
        {"openvdb", MethodKind::kPeer, {}},
        {"nanoflann-float", MethodKind::kPeer, {}},
        {"nanoflann-double", MethodKind::kPeer, {}},
        {"treensearch", MethodKind::kPeer, {}},
        {"brute-force", MethodKind::kPeer, {}},
    };
    return list;
}

constexpr std::uint64_t kMostBruteForce = 50'000; // points: 2.5 * 10^9 tests, some seconds
constexpr std::uint64_t kMostPeers = 5'000'000;   // points: a tree takes some seconds a run

MethodSpec engineSpec(const EncodingName& encoding)
{
    MethodSpec spec;
    spec.family = "ours";
    spec.encoding = encoding.encoding;
    spec.name = spec.family + "-" + encoding.name;
    return spec;
}

MethodSpec visitSpec()
{
    MethodSpec spec = engineSpec(kEncodings[2]);
    spec.name = "ours-visit";
    spec.visits = true;
    return spec;
}

MethodSpec deviceSpec(const Family& family, const EncodingName& encoding)
{
    MethodSpec spec;
    spec.kind = MethodKind::kDevice;
    spec.family = family.name;
    spec.place = family.place;
    spec.boundary = family.boundary;
    spec.blockLog2Cells = family.blockLog2Cells;
    spec.encoding = encoding.encoding;
    spec.name = spec.family + "-" + encoding.name;
    return spec;
}

MethodSpec singleSpec(const Single& single, double number)
{
    MethodSpec spec;
    spec.kind = single.kind;
    spec.family = single.name;
    spec.number = number;
    spec.name = spec.family;
    if (number > 0) spec.name += std::to_string(static_cast<int>(number));
    return spec;
}

std::vector<MethodSpec> engineGroup()
{
    std::vector<MethodSpec> specs;
    for (const EncodingName& encoding : kEncodings) specs.push_back(engineSpec(encoding));
    specs.push_back(visitSpec());
    return specs;
}

// Both encodings of lists; `mapped` has a link to read through on CUDA devices only.
std::vector<MethodSpec> deviceGroup(const std::string& device)
{
    const bool isCuda = device.compare(0, 4, "cuda") == 0;
    std::vector<MethodSpec> specs;
    for (const Family& family : kDeviceFamilies) {
        if (family.place == MethodPlace::kMapped && !isCuda) continue;
        for (const EncodingName& encoding : kEncodings) {
            if (encoding.encoding != Encoding::kNone) specs.push_back(deviceSpec(family, encoding));
        }
    }
    return specs;
}

std::vector<MethodSpec> singleGroup(MethodKind kind, std::uint64_t points)
{
    std::vector<MethodSpec> specs;
    for (const Single& single : singles()) {
        if (single.kind != kind || !missingPeer(single.name).empty()) continue;
        if (kind == MethodKind::kPeer) {
            const bool isBruteForce = std::string(single.name) == "brute-force";
            if (points > (isBruteForce ? kMostBruteForce : kMostPeers)) continue;
        }
        if (single.numbers.empty()) specs.push_back(singleSpec(single, 0));
        for (const int number : single.numbers) specs.push_back(singleSpec(single, number));
    }
    return specs;
}

std::optional<std::vector<MethodSpec>> groupOf(const std::string& name, const MethodSuits& suits)
{
    if (name == "ours") return engineGroup();
    if (name == "devices") return deviceGroup(suits.device);
    if (name == "parts") return singleGroup(MethodKind::kAblation, 0);
    if (name == "approximate") return singleGroup(MethodKind::kApproximate, 0);
    if (name == "peers") return singleGroup(MethodKind::kPeer, 0);
    return std::nullopt;
}

std::vector<MethodSpec> defaultMethods(const MethodSuits& suits)
{
    std::vector<MethodSpec> specs;
    for (const char* group : {"ours", "devices", "parts", "approximate", "peers"}) {
        if (group == std::string("devices") && suits.device.empty()) continue;
        const bool isPeers = group == std::string("peers"); // the slow ones where there are few points
        const std::vector<MethodSpec> more =
            isPeers ? singleGroup(MethodKind::kPeer, suits.points) : *groupOf(group, suits);
        specs.insert(specs.end(), more.begin(), more.end());
    }
    return specs;
}

// "nearest32": the number behind the name, within its limits.
std::optional<MethodSpec> numberedSpec(const Single& single, const std::string& name)
{
    const std::string family = single.name;
    if (single.numbers.empty() || name.compare(0, family.size(), family) != 0) return std::nullopt;
    int number = 0;
    const char* const begin = name.data() + family.size();
    const char* const end = name.data() + name.size();
    const auto [stop, error] = std::from_chars(begin, end, number);
    if (error != std::errc() || stop != end) return std::nullopt;
    const int most = family == "sampled" ? 100 : 1'000'000;
    if (number < 1 || number > most) {
        throw InvalidInput("--method: '" + name + "': the number is 1 to " + std::to_string(most));
    }
    return singleSpec(single, number);
}

MethodSpec parseWithoutThreads(const std::string& name)
{
    for (const MethodSpec& spec : engineGroup()) {
        if (spec.name == name) return spec;
    }
    for (const Family& family : kDeviceFamilies) {
        for (const EncodingName& encoding : kEncodings) {
            MethodSpec spec = deviceSpec(family, encoding);
            if (spec.name == name) return spec;
        }
    }
    for (const Single& single : singles()) {
        const std::optional<MethodSpec> numbered = numberedSpec(single, name);
        if (!numbered && (name != single.name || !single.numbers.empty())) continue;
        const std::string missing = missingPeer(single.name);
        if (!missing.empty()) throw InvalidInput("--method " + name + ": " + missing);
        return numbered ? *numbered : singleSpec(single, 0);
    }
    throw InvalidInput("--method: '" + name + "' is not known; there are " + methodHelp());
}

} // namespace

std::string methodHelp()
{
    std::string devices, others;
    for (const Family& family : kDeviceFamilies)
        devices += (devices.empty() ? "" : ", ") + std::string(family.name);
    for (const Single& single : singles()) {
        others += ", " + std::string(single.name);
        if (single.kind == MethodKind::kApproximate)
            others += "N (e.g. " + singleSpec(single, single.numbers.front()).name + ")";
    }
    return "ours-index, ours-mask, ours-count, ours-visit" + others +
           "; on devices FAMILY-index, -mask or -count with " + devices +
           "; groups ours, devices, parts, approximate, peers; NAME@T for T threads";
}

MethodSpec parseMethod(const std::string& name)
{
    const std::size_t at = name.find('@');
    MethodSpec spec = parseWithoutThreads(name.substr(0, at));
    if (at == std::string::npos) return spec;
    const char* const end = name.data() + name.size();
    const auto [stop, error] = std::from_chars(name.data() + at + 1, end, spec.threads);
    if (error != std::errc() || stop != end || spec.threads < 1 || spec.threads > kMostThreads) {
        throw InvalidInput("--method: '" + name + "': after the @ stands a number of threads, 1 to " +
                           std::to_string(kMostThreads));
    }
    spec.name = name;
    return spec;
}

std::vector<MethodSpec> parseMethods(const std::string& list, const MethodSuits& suits)
{
    if (list.empty()) return defaultMethods(suits);
    std::vector<MethodSpec> specs;
    const auto add = [&specs](const MethodSpec& spec) {
        const auto isSame = [&](const MethodSpec& other) { return other.name == spec.name; };
        if (std::none_of(specs.begin(), specs.end(), isSame)) specs.push_back(spec);
    };
    std::istringstream parts(list);
    for (std::string name; std::getline(parts, name, ',');) {
        if (const auto group = groupOf(name, suits)) {
            for (const MethodSpec& spec : *group) add(spec);
        } else {
            add(parseMethod(name));
        }
    }
    return specs;
}

namespace {

std::string missingInTreeNSearch(const SetSearch& search)
{
    if (!search.radius.isOne() && search.radius.mode == RadiusMode::kScatter)
        return "has no radii of candidates alone";
    if (search.nearest > 0) return "has no search of the nearest";
    const bool hasRoles = !search.queries.chosen.empty() || !search.candidates.chosen.empty();
    return hasRoles || !search.isOneSet() ? "is asked for one set here" : "";
}

} // namespace

std::string missingSearch(const MethodSpec& spec, const SetSearch& search)
{
    if (search.isPlain()) return {};
    const bool isGather = search.radius.isOne() || search.radius.mode == RadiusMode::kGather;
    switch (spec.kind) {
    case MethodKind::kEngine:
        return search.nearest > 0 && spec.encoding == Encoding::kMask ? "holds no masks of the nearest" : "";
    case MethodKind::kDevice:
        return "devices search all particles within one radius";
    case MethodKind::kAblation:
    case MethodKind::kApproximate:
        return "searches all particles within one radius";
    case MethodKind::kPeer:
        break;
    }
    if (spec.family == "brute-force") return {};
    if (spec.family == "treensearch") return missingInTreeNSearch(search);
    if (!isGather) return "has no radii of candidates";
    return search.nearest > 0 && spec.family == "openvdb" ? "has no search of the nearest" : "";
}

std::string missingMeasures(const MethodSpec& spec, const SetSearch& search)
{
    if (spec.kind == MethodKind::kDevice) return "measures are made on the CPU, whoever finds the lists";
    return spec.kind == MethodKind::kEngine ? missingSearch(spec, search) : "has no measures";
}

std::unique_ptr<Method> makeMethod(const MethodSpec& spec, const MethodSetup& setup)
{
    switch (spec.kind) {
    case MethodKind::kEngine:
        return makeEngineMethod(spec, setup.options);
    case MethodKind::kDevice:
        return makeDeviceMethod(spec, setup.options, setup.devices);
    case MethodKind::kAblation:
    case MethodKind::kApproximate:
        return makeAblationMethod(spec, setup.options, setup.voxelSize);
    case MethodKind::kPeer:
        break;
    }
    return makePeerMethod(spec);
}

} // namespace vdb_nns::cli

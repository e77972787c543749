#include "bench/methods.h"

#include "machine.h"
#include "vdb_nns/error.h"

#include <algorithm>
#include <sstream>

namespace vdb_nns::cli {
namespace {

class OurMethod : public Method {
public:
    explicit OurMethod(const SearchOptions& options) : mOptions(options) {}

    MethodRun run(const ParticleView& view, double radius) override
    {
        discard();
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

    void discard() override { mLists = NeighborLists(); }
    bool hasLists() const override { return mOptions.encoding != Encoding::kNone; }
    std::uint32_t count(std::size_t i) const override { return mLists.count(i); }
    void neighbors(std::size_t i, std::vector<std::uint32_t>& out) const override
    {
        mLists.neighbors(i, out);
    }

private:
    SearchOptions mOptions;
    SearchEngine mEngine;
    NeighborLists mLists;
};

} // namespace

const std::vector<std::string>& methodNames()
{
    static const std::vector<std::string> names = {"ours-index", "ours-mask", "ours-count"};
    return names;
}

std::unique_ptr<Method> makeMethod(const std::string& name, const SearchOptions& options)
{
    SearchOptions own = options;
    if (name == "ours-index") {
        own.encoding = Encoding::kIndex;
    } else if (name == "ours-mask") {
        own.encoding = Encoding::kMask;
    } else if (name == "ours-count") {
        own.encoding = Encoding::kNone;
    } else {
        throw InvalidInput("--method: '" + name + "' is not known; use ours-index, ours-mask, ours-count");
    }
    return std::make_unique<OurMethod>(own);
}

std::vector<std::string> parseMethods(const std::string& list)
{
    if (list.empty()) return methodNames();
    std::vector<std::string> names;
    std::istringstream parts(list);
    for (std::string name; std::getline(parts, name, ',');) {
        makeMethod(name, {}); // refuses unknown names
        if (std::find(names.begin(), names.end(), name) == names.end()) names.push_back(name);
    }
    return names;
}

} // namespace vdb_nns::cli

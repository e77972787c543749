// Sample scenes: names, parameters and their limits, and the way to the generators (scene_families.h).
#include "vdb_nns/scene.h"

#include "scene_families.h"
#include "util/isolate.h"
#include "vdb_nns/error.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <sstream>

namespace vdb_nns {

namespace {

struct Entry {
    SceneName name;
    scenes::Generator generate;
};

const std::vector<Entry>& entries()
{
    static const std::vector<Entry> kEntries = {
        {{"block", "jittered cubic lattice: the bulk of a fluid"}, scenes::makeBlock},
        {{"dam_break", "bulk, splash and spray over a floor"}, scenes::makeDamBreak},
        {{"two_sources", "two jets meeting in a disc"}, scenes::makeTwoSources},
        {{"sheet", "curved sheets of one to three particle layers"}, scenes::makeSheet},
        {{"spray", "sheets, droplets and ballistic spray in a huge empty box"}, scenes::makeSpray},
        {{"clusters", "log-normal clusters, from no neighbor to thousands"}, scenes::makeClusters},
        {{"lattice", "exact lattice whose radius is exactly 2 h: ties"}, scenes::makeLattice},
        {{"coincident", "all particles, or a fraction of them, at one point"}, scenes::makeCoincident},
        {{"outlier", "a block and one particle far away"}, scenes::makeOutlier},
        {{"far", "a block far from the origin"}, scenes::makeFar},
        {{"seam", "small blocks across zero and every node face"}, scenes::makeSeam},
    };
    return kEntries;
}

const Entry& findEntry(const std::string& name)
{
    std::string known;
    for (const Entry& entry : entries()) {
        if (name == entry.name.name) return entry;
        known += known.empty() ? "" : ", ";
        known += entry.name.name;
    }
    throw InvalidInput("unknown scene '" + name + "'; the scenes are " + known);
}

std::string number(double value)
{
    std::ostringstream text;
    text << value;
    return text.str();
}

// `value` must be in [low, high]; the negated test also refuses NaN.
void checkRange(const char* option, const std::optional<double>& value, double low, double high)
{
    if (!value || (*value >= low && *value <= high)) return;
    throw InvalidInput(std::string("scene: --") + option + " is " + number(*value) + "; it must be from " +
                       number(low) + " to " + number(high));
}

void checkLength(const char* option, const std::optional<double>& value)
{
    // Far inside the range of double, so that no product of two of them overflows or vanishes.
    if (!value || (*value >= 1e-30 && *value <= 1e30)) return;
    throw InvalidInput(std::string("scene: --") + option + " is " + number(*value) +
                       "; it must be a positive number from 1e-30 to 1e30");
}

void checkBelongs(const SceneOptions& options, const char* option, const std::optional<double>& value,
                  const char* scene)
{
    if (!value || options.name == scene) return;
    throw InvalidInput(std::string("scene: --") + option + " belongs to the scene '" + scene + "', not to '" +
                       options.name + "'");
}

void checkOptions(const SceneOptions& options)
{
    constexpr std::uint64_t kMaxCount = std::numeric_limits<std::uint32_t>::max();
    if (options.count < 1 || options.count > kMaxCount) {
        throw InvalidInput("scene: " + std::to_string(options.count) + " particles; -n must be from 1 to " +
                           std::to_string(kMaxCount));
    }
    checkBelongs(options, "offset", options.offset, "far");
    checkBelongs(options, "distance", options.distance, "outlier");
    checkBelongs(options, "fraction", options.fraction, "coincident");
    checkLength("spacing", options.spacing);
    checkLength("radius-factor", options.radiusFactor);
    checkLength("voxel-size", options.voxelSize);
    // Voxel coordinates are 32-bit; the block beside the offset needs some room.
    checkRange("offset", options.offset, -2.1e9, 2.1e9);
    checkRange("distance", options.distance, 0, 2.1e9);
    checkRange("fraction", options.fraction, 0, 1);
}

} // namespace

const std::vector<SceneName>& sceneNames()
{
    static const std::vector<SceneName> kNames = [] {
        std::vector<SceneName> names;
        for (const Entry& entry : entries()) names.push_back(entry.name);
        return names;
    }();
    return kNames;
}

Scene makeScene(const SceneOptions& options, Progress* progress)
{
    const Entry& entry = findEntry(options.name);
    checkOptions(options);
    const double h = options.spacing.value_or(0.1);
    Scene scene;
    scene.suggestedRadius = options.radiusFactor.value_or(2.0) * h;
    scene.voxelSize = options.voxelSize.value_or(options.name == "lattice" ? h : 2 * h);
    const CancelCheck cancel(progress, "scene");
    const std::size_t coordinates = 3 * options.count;
    scene.positions.reserve(coordinates);
    while (scene.positions.size() < coordinates) { // the memory comes page by page: 0.2 s a GB
        cancel.check();
        scene.positions.resize(std::min(coordinates, scene.positions.size() + (std::size_t(1) << 23)));
    }
    isolated([&] {
        entry.generate({options, options.count, h, scene.suggestedRadius, scene.voxelSize,
                        scene.positions.data(), cancel});
    });
    return scene;
}

} // namespace vdb_nns

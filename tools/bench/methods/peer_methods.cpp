#include "bench/methods/other_methods.h"
#include "bench/methods/peers.h"
#include "vdb_nns/error.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <stdexcept>

namespace vdb_nns::cli {

template <typename Real>
std::vector<Real> worldPositions(const ParticleView& view)
{
    std::vector<Real> positions(3 * view.size());
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, view.size(), 8192), [&](const auto& range) {
        for (std::size_t i = range.begin(); i < range.end(); ++i) {
            const Vec3d at = view.worldPosition(i);
            for (std::size_t k = 0; k < 3; ++k) positions[3 * i + k] = static_cast<Real>(at[k]);
        }
    });
    return positions;
}

template std::vector<float> worldPositions(const ParticleView&);
template std::vector<double> worldPositions(const ParticleView&);

template <typename Real>
Members<Real> membersOf(const ParticleSet& set)
{
    Members<Real> members;
    members.xyz = worldPositions<Real>(set.view);
    if (set.chosen.empty()) return members;
    for (std::size_t i = 0; i < set.view.size(); ++i) {
        if (set.chosen[i] == 0) continue;
        for (std::size_t k = 0; k < 3; ++k)
            members.xyz[3 * members.numbers.size() + k] = members.xyz[3 * i + k];
        members.numbers.push_back(static_cast<std::uint32_t>(i));
    }
    members.xyz.resize(3 * members.numbers.size());
    return members;
}

template Members<float> membersOf(const ParticleSet&);
template Members<double> membersOf(const ParticleSet&);

std::string missingPeer(const std::string& family)
{
    if (family == "treensearch" && !hasTreeNSearch()) {
        return "TreeNSearch was not there when this program was built; get its sources, configure with "
               "-DVDB_NNS_TREENSEARCH=FOLDER and build again";
    }
    if (family.rfind("nanoflann", 0) != 0 || hasNanoflann()) return {};
    return "nanoflann was not there when this program was built; install libnanoflann-dev and build again";
}

std::unique_ptr<Method> makePeerMethod(const MethodSpec& spec)
{
    const std::string missing = missingPeer(spec.family);
    if (!missing.empty()) throw InvalidInput(spec.name + ": " + missing);
    if (spec.family == "openvdb") return makeOpenVdbPeer();
    if (spec.family == "nanoflann-float") return makeNanoflannPeer(false);
    if (spec.family == "nanoflann-double") return makeNanoflannPeer(true);
    if (spec.family == "treensearch") return makeTreeNSearchPeer();
    if (spec.family == "brute-force") return makeBruteForce();
    throw std::logic_error("bench: no peer " + spec.family);
}

} // namespace vdb_nns::cli

// The methods that `bench` puts side by side, behind one interface.
#pragma once

#include "vdb_nns/neighbor_lists.h"
#include "vdb_nns/particle_view.h"
#include "vdb_nns/search.h"

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

namespace vdb_nns::cli {

struct MethodRun {
    double gridSeconds = 0, searchSeconds = 0;
    std::uint64_t pairs = 0, structureBytes = 0, listBytes = 0;
};

/// A way to find all neighbors. Keeps its buffers from run to run.
class Method {
public:
    virtual ~Method() = default;

    /// Structure and lists anew. The result stays until the next run or discard().
    virtual MethodRun run(const ParticleView& view, double radius) = 0;
    /// Drops the result, so that its memory can be used again.
    virtual void discard() = 0;
    /// Whether lists exist, or counts only.
    virtual bool hasLists() const = 0;
    virtual std::uint32_t count(std::size_t i) const = 0;
    /// @throws InvalidInput without lists
    virtual void neighbors(std::size_t i, std::vector<std::uint32_t>& out) const = 0;
};

const std::vector<std::string>& methodNames();

/// @throws InvalidInput for an unknown name
std::unique_ptr<Method> makeMethod(const std::string& name, const SearchOptions& options);

/// Names from a list with commas, checked; all methods for an empty list.
/// @throws InvalidInput
std::vector<std::string> parseMethods(const std::string& list);

} // namespace vdb_nns::cli

// Flags about who asks, among whom, and how far (design: queries, candidates, radii), and what they name in files.
#pragma once

#include "cli_options.h"
#include "device_options.h"
#include "vdb_nns/particle_set.h"
#include "vdb_nns/point_file.h"

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace vdb_nns::cli {

struct QueryFlags {
    std::string queries, queriesGrid, queryGroup, candidateGroup, radiusAttribute, radiusFile,
        queriesRadiusFile, radiusScale = "1", radiusMode = "gather", nearest, order = "number";
    bool includeSelf = false;
    bool givesScale = false, givesMode = false; // whether the flags are there, be it with their defaults
};
void addQueryFlags(CLI::App& app, QueryFlags& flags);

/// What the flags ask for.
struct QueryPlan {
    bool hasQueries = false; ///< rows are the points of another file or grid
    bool hasRoles = false;   ///< that, or groups
    bool hasRadii = false;   ///< of particles
    double radiusScale = 1;
    RadiusMode mode = RadiusMode::kGather;
    std::uint32_t nearest = 0; ///< 0: all
    bool byDistance = false, includeSelf = false;

    bool isForDevices() const { return !hasRoles && !hasRadii && nearest == 0 && !includeSelf; }
    bool isPlain() const { return isForDevices() && !byDistance; }
    bool readsQueryRadii() const { return hasRadii && mode != RadiusMode::kScatter; }
    bool readsCandidateRadii() const { return hasRadii && mode != RadiusMode::kGather; }
};

/// Checks the flags, alone and together, without a look at a file.
/// @throws InvalidInput
QueryPlan checkQueryFlags(const QueryFlags& flags, const InputFlags& input);

/// The flags about devices for such a search: where devices do not run it, auto is the CPU.
/// @throws InvalidInput where they demand a device then
DeviceFlags deviceFor(const DeviceFlags& given, const QueryPlan& plan);

/// Files that the flags name, for checkOutputs().
std::vector<std::string> queryFiles(const QueryFlags& flags);

/// How the file of the queries is read, be it IN again: of IN's flags, --columns and --array count for one of its format.
/// @throws InvalidInput as pointFileOptions()
PointFileOptions queryFileOptions(const QueryFlags& flags, const InputFlags& input,
                                  std::uint64_t hostMemoryBytes, Progress* progress);

/// The particles of a search, who of them has which role, and their radii.
struct QueryInput {
    PointFile candidates;
    std::optional<PointFile> queries; ///< none: the candidates
    /// By particle number: not 0 for those of the groups chosen; empty: all.
    std::vector<std::uint8_t> queryChosen, candidateChosen;
    /// By particle number, times the scale; empty where they are not read. Without other queries candidateRadii stays empty
    /// where the queries' are read: they are the same.
    std::vector<double> queryRadii, candidateRadii;
    /// Particles whose radius is read and is NaN, infinite or not positive, among those of the groups chosen.
    std::uint64_t badRadii = 0;
    QueryPlan plan;

    // Views of this, which must stay where it is.
    ParticleSet querySet() const;
    ParticleSet candidateSet() const;
    /// @param one the radius of all pairs; not read if particles have their own.
    Radius radius(double one) const;
    /// The largest finite radius of particles, 0 without one; where one serves all, that.
    double largestRadius(double one) const;
};

/// Reads the other points, the groups and the radii that a plan needs.
/// @param hostMemoryBytes what reading the other points may take; 0: what is free
/// @param progress may be null
/// @throws InvalidInput for names that are not there, and for a choice that a format does not offer; InputError for values
///         of the wrong type or number, and as PointFile::read()
QueryInput readQueryInput(PointFile candidates, const QueryFlags& flags, const QueryPlan& plan,
                          const InputFlags& input, std::uint64_t hostMemoryBytes, Progress* progress);

} // namespace vdb_nns::cli

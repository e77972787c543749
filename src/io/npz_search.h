// A search that is written as .npz while it runs: no lists are held, and rows are found once.
#pragma once

#include "search/engine_state.h"
#include "vdb_nns/neighbor_lists.h"
#include "vdb_nns/point_file.h"

#include <cstdint>
#include <optional>
#include <string>

namespace vdb_nns {

struct NpzSearchOptions {
    std::string path;
    ListValues values = ListValues::kConnectivity;
    OutputOptions output;
    bool checksum = false;
    std::uint64_t windowBytes = 0; // that rows may take which wait for those before them
};

struct NpzSearchResult {
    NeighborLists lists; // counts alone
    std::uint64_t checksum = 0;
    double writeSeconds = 0; // for what could be written only once all rows were found
};

// Empty, and nothing written, if too many rows would wait for others, as those of particles in random order do. Throws as
// SearchEngine::search() and writeNpz(). `search.encoding` and `search.hostMemoryBytes` are not read.
std::optional<NpzSearchResult> searchToNpz(EngineState& engine, const SparseGrid& grid,
                                           const SearchOptions& search, const NpzSearchOptions& options);

} // namespace vdb_nns

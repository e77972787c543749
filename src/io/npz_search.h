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
    ListForm form;
    OutputOptions output;
    bool checksum = false;
    std::uint64_t windowBytes = 0; // most memory of rows that wait for those before them; 0: none may
};

struct NpzSearchResult {
    NeighborLists lists; // counts alone
    std::uint64_t checksum = 0;
    double writeSeconds = 0; // for what could be written only once all rows were found
};

// Returns nothing, and writes nothing, if the rows that must wait for others do not fit in `windowBytes`;
// that is so for particles that are numbered in random order, and for sets on several lattices. Throws what SearchEngine::search() and
// writeNpz() throw. Ignores `search.encoding` and `search.hostMemoryBytes`.
std::optional<NpzSearchResult> searchToNpz(EngineState& engine, const SearchSets& sets,
                                           const SearchOptions& search, const NpzSearchOptions& options);

} // namespace vdb_nns

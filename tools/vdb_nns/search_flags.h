// Flags of `vdb_nns search`, and what they ask for once all that can be checked without reading a byte is.
#pragma once

#include "attribute_output.h"
#include "cli_options.h"
#include "device_options.h"
#include "measure_options.h"
#include "query_options.h"
#include "vdb_nns/search_job.h"

#include <CLI/CLI.hpp>

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace vdb_nns::cli {

struct SearchFlags {
    CommonFlags common;
    InputFlags input;
    QueryFlags query;
    MeasureFlags measure;
    EngineFlags engine;
    std::vector<std::string> outputs;
    std::string attributesOutput, voxelSize, keep = "all";
    bool givesKeep = false; // whether the flag is there
    DeviceFlags device;
    std::string encoding, lists = "connectivity";
    std::string repeat = "1", nonfinite = "skip";
    bool checksum = false;
    std::string frames; // numbers; empty: IN is one file
    bool skipExisting = false;
    std::string tile; // K/N; empty: all rows
};

/// --tile K/N.
struct TileChoice {
    std::uint32_t tile = 0; ///< from 1
    std::uint32_t tiles = 0;
};

/// Flags after all that can be checked before reading.
struct SearchPlan {
    JobOptions job;
    QueryPlan query;
    MeasurePlan measure;
    AttributeOutputs attributes;
    std::optional<double> voxelSize; // of a new .vdb; else the radius
    std::optional<TileChoice> tile;
    bool readsTileAlone = false; ///< and what is around it
    int threads = 0;
    std::uint64_t repeat = 1;

    bool writesAttributes() const { return !attributes.points.empty() || !attributes.arrays.empty(); }
};

void addSearchFlags(CLI::App& app, SearchFlags& flags);

/// What is looked at of files that are to be written.
struct OutputChecks {
    bool existing = true; ///< those that exist are refused without --force
    bool report = true;   ///< --json too
};

/// Everything that can be wrong without reading a byte. The devices of the job are not opened yet: see deviceFor().
/// @throws InvalidInput, OutputExists, OutputError; CapacityError for less memory than the program itself takes
SearchPlan checkSearchFlags(const SearchFlags& flags, const OutputChecks& checks = {});

/// What the rows of an .npz are like.
ListForm listForm(const SearchFlags& flags, const SearchPlan& plan);

} // namespace vdb_nns::cli

// What a subcommand is: flags that it adds to the command line, and a function that runs it.
#pragma once

#include <CLI/CLI.hpp>

#include <functional>
#include <string>
#include <vector>

namespace vdb_nns::cli {

/// Shared by a subcommand and the handler of its errors.
struct Session {
    std::string path, grid;  ///< at work: errors of the engine, which knows no files, are prefixed with them
    std::string otherPath;   ///< another file at work: errors that begin with its name are about it
    std::string memoryFlags; ///< of the command, that help where memory does not suffice, as a list; or none
};

struct Command {
    CLI::App* app;
    std::function<int(Session&)> run; ///< returns the exit code
};

Command addSearchCommand(CLI::App& app);
Command addPlanCommand(CLI::App& app);
Command addSceneCommand(CLI::App& app);
Command addVerifyCommand(CLI::App& app);
Command addBenchCommand(CLI::App& app);
Command addConvertCommand(CLI::App& app);
Command addMergeCommand(CLI::App& app);
Command addInfoCommand(CLI::App& app);

} // namespace vdb_nns::cli

// The command line as a whole: its subcommands, and what becomes of their errors.
#pragma once

namespace vdb_nns::cli {

/// Parses, runs one subcommand and returns the exit code. Throws nothing; errors go to stderr.
int runCommandLine(int argc, char** argv);

} // namespace vdb_nns::cli

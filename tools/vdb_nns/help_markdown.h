// The flag tables of docs/cli.md, made from the parser's own options so that it cannot drift.
#pragma once

#include <CLI/CLI.hpp>

#include <string>

namespace vdb_nns::cli {

std::string helpMarkdown(const CLI::App& app);

} // namespace vdb_nns::cli

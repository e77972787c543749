// The words of a command line: `help`, and words that no command or flag takes.
#pragma once

#include <CLI/CLI.hpp>

#include <string>
#include <vector>

namespace vdb_nns::cli {

/// `help`, also said twice, is `--help`, `help COMMAND` is `COMMAND --help`, and a command line without a
/// word asks for help too.
std::vector<std::string> withHelp(std::vector<std::string> words);

/// An error message about the words, in the order typed, that the parser could not place, with the name
/// nearest to one of them; empty where it placed all. The parser allows extras.
std::string unknownWords(const CLI::App& app);

} // namespace vdb_nns::cli

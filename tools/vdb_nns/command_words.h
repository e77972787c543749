// The words of a command line: `help`, and words that no command or flag takes.
#pragma once

#include <CLI/CLI.hpp>

#include <string>
#include <vector>

namespace vdb_nns::cli {

/// The name that a word was meant to be: one that it begins, or the one at most two edits away; empty if none is.
std::string nearestName(const std::string& word, const std::vector<std::string>& names);

/// `help`, also said twice, is `--help`, `help COMMAND` is `COMMAND --help`, and a command line without a
/// word asks for help too.
std::vector<std::string> withHelp(std::vector<std::string> words);

/// An error message about the words, in the order typed, that the parser could not place, with the name
/// nearest to one of them; empty where it placed all. The parser allows extras.
std::string unknownWords(const CLI::App& app);

} // namespace vdb_nns::cli

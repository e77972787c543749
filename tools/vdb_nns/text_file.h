// Files and standard output that the command line writes itself.
#pragma once

#include <cstddef>
#include <string>

namespace vdb_nns::cli {

/// Writes a whole file: it appears complete or not at all (temporary name beside the target, then rename).
/// @throws OutputExists, OutputError
void writeWholeFile(const std::string& path, const void* data, std::size_t bytes, bool overwrite);

/// Writes to standard output and flushes it.
/// @throws OutputError when not all of it could be written
void writeStdout(const std::string& text);

} // namespace vdb_nns::cli

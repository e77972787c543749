// Files and standard output that the command line writes itself.
#pragma once

#include <cstddef>
#include <string>

namespace vdb_nns::cli {

/// Opens those of the descriptors 0 to 2 that are closed on /dev/null: the next file that is opened would get their
/// number, and what is said on stderr would be written into it. Before anything is opened.
/// @returns false where that cannot be done, which it says if it can
bool openStandardStreams();

/// Writes a whole file: it appears complete or not at all (temporary name beside the target, then rename).
/// @throws OutputExists, OutputError
void writeWholeFile(const std::string& path, const void* data, std::size_t bytes, bool overwrite);

/// Writes to standard output and flushes it.
/// @throws OutputError when not all of it could be written
void writeStdout(const std::string& text);

} // namespace vdb_nns::cli

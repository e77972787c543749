// How files are written, and what becomes of a file whose writer is killed.
#pragma once

#include <cstddef>
#include <string>

namespace vdb_nns {

/// How every writer of this library treats its target. A file appears whole or not at all: it is written
/// beside its target as `TARGET.vdb_nns-HOST-PROCESS-COUNT.tmp` and renamed at the end. HOST stands for the
/// name of the host; all three are hexadecimal. If the target is a symbolic link, the file it leads to is
/// replaced. A replaced file keeps its permissions; those of a new one follow the umask of the process. A
/// temporary file that a killed process left is removed by the next writer of the same target on the same
/// host.
struct OutputOptions {
    /// Whether a file that exists may be replaced.
    bool overwrite = false;
    /// Whether the file is flushed to the disk before it takes its name, and its folder after. Slower, but
    /// what is written survives a power loss. Without it, a power loss within some seconds leaves what the
    /// file system happens to leave: the old file, the new one, or an empty one.
    bool sync = false;
};

/// Writes bytes to a file.
/// @throws OutputExists, OutputError
void writeFile(const std::string& path, const void* data, std::size_t bytes,
               const OutputOptions& options = {});

/// Fails early, before a long search, if `path` could not be written: it exists and may not be overwritten,
/// it is not a regular file, or its folder does not exist.
/// @throws OutputExists, OutputError
void checkOutput(const std::string& path, bool overwrite);

/// Removes the temporary files of this process; it knows at most 64 at a time. For the handler of a signal
/// that ends the process, since the library installs no signal handlers. A writer that goes on regardless
/// fails at its end. Async-signal-safe; waits for nobody.
void removeTemporaryFiles() noexcept;

} // namespace vdb_nns

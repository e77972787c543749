// `vdb_nns search --frames`: one search after the other over the files of a sequence. While one is searched, the next is read and the
// last one written.
#pragma once

#include "command.h"
#include "search_flags.h"

namespace vdb_nns::cli {

/// Searches every frame of the flags, and goes on where one fails, which it says.
/// @param session of the command
/// @returns the exit code: that of the lowest frame that failed
/// @throws InvalidInput, OutputExists and OutputError as checkSearchFlags(), for any frame, before one is read; InputError if
///         no frame is there; Cancelled
int searchFrames(const SearchFlags& flags, const Session& session);

} // namespace vdb_nns::cli

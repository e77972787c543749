// What an exception means to who typed the command: an exit code and a sentence.
#pragma once

#include "command.h"

#include <string>

namespace vdb_nns::cli {

struct Failure {
    int code; ///< of exit_codes.h
    std::string message;
};

/// Of the exception that is being handled: the one place where exceptions become exit codes. Called inside a catch block.
/// @param session what was at work, which the message names
/// @throws Cancelled if that is the exception
Failure failureOf(const Session& session);

} // namespace vdb_nns::cli

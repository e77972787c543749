// What happens where the system makes no more threads. Some are made before main() (OpenVDB's logging
// library) or by TBB's workers, where no exception of theirs can be caught.
#pragma once

#include <exception>
#include <string>

namespace vdb_nns::cli {

/// Whether the exception says that a thread could not be made.
bool isThreadFailure(const std::exception& error);

/// What to do about it.
std::string threadAdvice(const std::exception& error);

/// Of several threads that are about to end the program, main() and workers of TBB say, the first goes on, to
/// say why. The others wait here for the end.
void claimEnd();

} // namespace vdb_nns::cli

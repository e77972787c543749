// What happens where the system makes no more threads, or has no more memory for them. Some are made before main() (OpenVDB's logging
// library) or by TBB's workers, where no exception of theirs can be caught.
#pragma once

#include <cstddef>
#include <exception>
#include <string>

namespace vdb_nns::cli {

/// Whether so many bytes can be had.
bool isFree(std::size_t bytes);

/// Whether the exception says that a thread could not be made.
bool isThreadFailure(const std::exception& error);

/// What to do about it.
std::string threadAdvice(const std::exception& error);

/// Of several threads that are about to end the program, main() and workers of TBB say, the first goes on, to
/// say why. The others wait here for the end.
void claimEnd();

} // namespace vdb_nns::cli

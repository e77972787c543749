// Methods of `bench` that are the engine on the CPU.
#pragma once

#include "bench/method.h"

#include <memory>

namespace vdb_nns::cli {

/// Lists of either encoding, counts alone, or rows that are handed to a visitor and not kept.
std::unique_ptr<Method> makeEngineMethod(const MethodSpec& spec, const SearchOptions& options);

} // namespace vdb_nns::cli

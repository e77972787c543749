// Whether named values are those of some points, and counts as an attribute.
#pragma once

#include "vdb_nns/point_values.h"

#include <cstdint>
#include <string>

namespace vdb_nns {

// Throws InvalidInput unless each attribute and group has a name that no other one of its kind has, and a value for each of
// so many points. `text` begins the message.
void checkValues(const std::string& text, const PointValues& values, std::uint64_t points);

// An int32 attribute that views the counts. Throws InvalidInput where one is above 2^31-1.
PointAttribute countAttribute(const std::string& text, const std::string& name,
                              Span<const std::uint32_t> counts);

} // namespace vdb_nns

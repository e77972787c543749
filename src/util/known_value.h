// Refuses values that an enum does not have.
#pragma once

#include "vdb_nns/error.h"

#include <string>
#include <type_traits>

namespace vdb_nns {

// `last` is the enum's last value; they begin with 0. Throws InvalidInput.
template <typename Enum>
void requireKnown(Enum value, Enum last, const char* name)
{
    using Number = std::underlying_type_t<Enum>;
    const auto number = static_cast<Number>(value), most = static_cast<Number>(last);
    if (number >= 0 && number <= most) return;
    throw InvalidInput(std::string(name) + " " + std::to_string(number) +
                       " is not known: its values are 0 to " + std::to_string(most));
}

} // namespace vdb_nns

// Which values a new file can have, by their names.
#pragma once

#include "vdb_nns/point_values.h"

#include <optional>
#include <set>
#include <string>

namespace vdb_nns {

enum class PointFormat { kVdb, kPly, kNpz, kNpy };

class ValueNames {
public:
    // @param id of a .vdb, the attribute that gets the points' numbers; empty: none
    // @param hasPositions whether an .npz has the array `positions`
    explicit ValueNames(PointFormat format, const std::string& id = {}, bool hasPositions = true);

    // Takes the name for an attribute of that type, or for a group, which has none. If the file cannot have it, returns why
    // not, as the end of a sentence that begins with the name; else an empty text.
    std::string add(const std::string& name, const std::optional<AttributeType>& type);

    // Throws InvalidInput where the file cannot have one of these. `path` begins the message.
    void addAll(const std::string& path, const PointValues& values);

private:
    std::string addToVdb(const std::string& name, bool isGroup);
    std::string addToPly(const std::string& name, AttributeType type);
    std::string addToNpz(const std::string& name);

    PointFormat mFormat;
    std::string mId;
    std::set<std::string> mTaken;
};

} // namespace vdb_nns

// What the two readers of .ply bodies, text and binary, are given.
#pragma once

#include "io/ply_header.h"

#include <vector>

namespace vdb_nns {

struct PlyBody {
    const ArrayFile& file;
    const PlyHeader& header;
    std::size_t vertex;                // element
    std::vector<std::size_t> property; // of it, that are read: x, y and z, or one alone
    bool isDouble;                     // unless all three are floats

    const PlyElement& vertexElement() const { return header.elements[vertex]; }
    const PlyProperty& read(std::size_t k) const { return vertexElement().properties[property[k]]; }
    // Numbers that are read of a vertex.
    std::size_t width() const { return property.size(); }
};

// Of one property the values are where positions stand otherwise: doubles, one a vertex.
// Both throw InputError unless all vertices are there as the header declares them, and where something is
// left over behind the last row of the last element. Elements behind the vertices may be cut off or damaged:
// a note says so.
ReadArray readPlyText(const PlyBody& body);
ReadArray readPlyBinary(const PlyBody& body);

inline std::string forgivenNote(const PlyBody& body, const std::string& what, const std::string& place)
{
    return "an element behind the vertices is damaged or cut off (" + what + " at " + place + "); the " +
           std::to_string(body.vertexElement().count) + " vertices are whole and were read";
}

} // namespace vdb_nns

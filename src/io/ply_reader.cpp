// The .ply reader. A header names elements and their properties; the rows follow as text (ply_text.cpp) or as
// packed binary values (ply_binary.cpp).
#include "io/fixed_rows.h"
#include "io/ply_body.h"

#include <algorithm>

namespace vdb_nns {

namespace {

std::size_t findProperty(const std::string& path, const PlyElement& vertex, const std::string& name)
{
    std::size_t found = vertex.properties.size();
    for (std::size_t i = 0; i < vertex.properties.size(); ++i) {
        if (vertex.properties[i].name != name) continue;
        if (found != vertex.properties.size())
            throw InputError(path + ": .ply property '" + name + "' is there twice");
        found = i;
    }
    if (found == vertex.properties.size()) {
        throw InputError(path + ": the .ply element 'vertex' has no property '" + name +
                         "'; positions are its properties x, y and z");
    }
    if (vertex.properties[found].isList)
        throw InputError(path + ": .ply property '" + name + "' is a list; a coordinate is one number");
    return found;
}

const char* typeName(NumberType type)
{
    const auto known = std::find_if(std::begin(kPlyTypeNames), std::end(kPlyTypeNames),
                                    [&](const PlyTypeName& name) { return name.type == type; });
    return known->name;
}

// Which properties were read, where they are not the reals that everybody expects.
std::string takenProperties(const PlyBody& body)
{
    const NumberType x = body.coordinate(0).type, y = body.coordinate(1).type, z = body.coordinate(2).type;
    if (isReal(x) && isReal(y) && isReal(z)) return {};
    const std::string properties = "properties x, y and z of type";
    if (x == y && y == z) return properties + " " + typeName(x);
    return properties + "s " + typeName(x) + ", " + typeName(y) + " and " + typeName(z);
}

} // namespace

ReadArray parsePly(const ArrayFile& file)
{
    const PlyHeader header = PlyHeaderReader(file.path, file.bytes).read();
    const auto vertex = std::find_if(header.elements.begin(), header.elements.end(),
                                     [](const PlyElement& element) { return element.name == "vertex"; });
    if (vertex == header.elements.end())
        throw InputError(file.path + ": the .ply file has no element 'vertex'");
    PlyBody body{file, header, static_cast<std::size_t>(vertex - header.elements.begin()), {}, false};
    for (std::size_t k = 0; k < 3; ++k) {
        body.property[k] = findProperty(file.path, *vertex, std::string(1, "xyz"[k]));
        body.isDouble = body.isDouble || body.coordinate(k).type != NumberType::kFloat;
    }
    ReadArray result = header.format == PlyFormat::kAscii ? readPlyText(body) : readPlyBinary(body);
    result.taken = takenProperties(body);
    return result;
}

} // namespace vdb_nns

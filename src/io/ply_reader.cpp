// The .ply reader. A header names elements and their properties; the rows follow as text (ply_text.cpp) or as
// packed binary values (ply_binary.cpp).
#include "io/fixed_rows.h"
#include "io/ply_body.h"
#include "util/nearest_name.h"
#include "util/shown_text.h"

#include <algorithm>
#include <iterator>

namespace vdb_nns {

namespace {

// The number of the property of that name; as many as there are if none has it.
std::size_t findProperty(const std::string& path, const PlyElement& vertex, const std::string& name)
{
    std::size_t found = vertex.properties.size();
    for (std::size_t i = 0; i < vertex.properties.size(); ++i) {
        if (vertex.properties[i].name != name) continue;
        if (found != vertex.properties.size())
            throw InputError(path + ": .ply property '" + shownText(name) + "' is there twice");
        found = i;
    }
    return found;
}

std::size_t findCoordinate(const std::string& path, const PlyElement& vertex, const std::string& name)
{
    const std::size_t found = findProperty(path, vertex, name);
    if (found == vertex.properties.size()) {
        throw InputError(path + ": the .ply element 'vertex' has no property '" + name +
                         "'; positions are its properties x, y and z");
    }
    if (vertex.properties[found].isList)
        throw InputError(path + ": .ply property '" + name + "' is a list; a coordinate is one number");
    return found;
}

std::size_t findScalar(const std::string& path, const PlyElement& vertex, const std::string& name)
{
    const std::size_t found = findProperty(path, vertex, name);
    if (found == vertex.properties.size()) {
        std::vector<std::string> names;
        for (const PlyProperty& property : vertex.properties) names.push_back(property.name);
        throw InvalidInput(path + ": the .ply element 'vertex' has no property '" + shownText(name) + "'" +
                           insteadText(name, names, "properties"));
    }
    if (vertex.properties[found].isList) {
        throw InputError(path + ": .ply property '" + shownText(name) + "' has type " +
                         vertex.properties[found].declared +
                         "; expected is a number a vertex, of any type but a list");
    }
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
    const NumberType x = body.read(0).type, y = body.read(1).type, z = body.read(2).type;
    if (isReal(x) && isReal(y) && isReal(z)) return {};
    const std::string properties = "properties x, y and z of type";
    if (x == y && y == z) return properties + " " + typeName(x);
    return properties + "s " + typeName(x) + ", " + typeName(y) + " and " + typeName(z);
}

std::size_t vertexElement(const std::string& path, const PlyHeader& header)
{
    const auto vertex = std::find_if(header.elements.begin(), header.elements.end(),
                                     [](const PlyElement& element) { return element.name == "vertex"; });
    if (vertex == header.elements.end()) throw InputError(path + ": the .ply file has no element 'vertex'");
    return static_cast<std::size_t>(vertex - header.elements.begin());
}

ReadArray readBody(const PlyBody& body)
{
    return body.header.format == PlyFormat::kAscii ? readPlyText(body) : readPlyBinary(body);
}

} // namespace

ReadArray parsePly(const ArrayFile& file)
{
    const PlyHeader header = PlyHeaderReader(file.path, file.bytes).read();
    PlyBody body{file, header, vertexElement(file.path, header), {}, false};
    for (const char* const name : {"x", "y", "z"}) {
        body.property.push_back(findCoordinate(file.path, body.vertexElement(), name));
        body.isDouble = body.isDouble || body.read(body.width() - 1).type != NumberType::kFloat;
    }
    ReadArray result = readBody(body);
    result.taken = takenProperties(body);
    for (const PlyProperty& property : body.vertexElement().properties)
        result.properties.push_back({property.name, property.declared});
    return result;
}

std::vector<double> parsePlyProperty(const ArrayFile& file, const std::string& name)
{
    const PlyHeader header = PlyHeaderReader(file.path, file.bytes).read();
    PlyBody body{file, header, vertexElement(file.path, header), {}, true};
    body.property.push_back(findScalar(file.path, body.vertexElement(), name));
    return readBody(body).positions.doubles;
}

} // namespace vdb_nns

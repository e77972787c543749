// Houdini's classic .bgeo, version 5, plain or in gzip (Partio's and SideFX's descriptions). All numbers are
// big-endian: "Bgeo", 'V', the version; the numbers of points, primitives, point groups, primitive groups,
// and of the attributes of points, vertices, primitives and the whole; a description of each attribute of
// points; and then for each point x y z w and its attributes, 4 bytes a value.
#include "file_numbers.h"
#include "point_formats.h"

#include <zlib.h>

#include <algorithm>

namespace vdb_nns::cli {

namespace {

// What a gzip file holds, or the bytes of any other one.
std::string plainBytes(const PointInput& input)
{
    std::string bytes = input.bytes();
    if (bytes.compare(0, 2, "\x1f\x8b") != 0) return bytes;
    const gzFile file = gzopen(input.path.c_str(), "rb");
    if (!file) input.fail("cannot be opened");
    std::string plain;
    char block[1 << 16];
    int got = 0;
    while ((got = gzread(file, block, sizeof block)) > 0) plain.append(block, static_cast<std::size_t>(got));
    const bool isWhole = gzclose(file) == Z_OK && got == 0;
    if (!isWhole) input.fail("has damaged gzip data");
    return plain;
}

class BgeoFile {
public:
    explicit BgeoFile(const PointInput& input) : mInput(input), mBytes(plainBytes(input)) {}

    Positions read()
    {
        if (mBytes.compare(0, 5, "BgeoV") != 0) mInput.fail("is no classic .bgeo file");
        mAt = 5;
        if (next('i', 4) != 5) mInput.fail("is a .bgeo file of a version other than 5");
        const double points = next('i', 4);
        double others = 0; // than points and their attributes
        for (int k = 0; k < 3; ++k) others += next('i', 4);
        const double attributes = next('i', 4);
        for (int k = 0; k < 3; ++k) others += next('i', 4);
        if (points < 0 || attributes < 0) mInput.fail("has a negative number of .bgeo points or attributes");
        std::uint64_t values = 4; // of a point
        for (double left = attributes; left > 0; --left) values += readAttribute();
        Positions positions;
        for (double left = points; left > 0; --left) {
            if (positions.size() / 3 % kRowsBetweenChecks == 0) mInput.checkCancelled();
            for (int k = 0; k < 3; ++k) positions.push_back(next('f', 4));
            skip(4 * (values - 3));
        }
        const std::string rest = mBytes.substr(mAt);
        if (others == 0 && !rest.empty() && rest != std::string("\x00\xff", 2))
            mInput.fail("has something behind the points of a .bgeo file that declares nothing else");
        return positions;
    }

private:
    void skip(std::uint64_t bytes)
    {
        if (bytes > mBytes.size() - mAt) mInput.fail("is a .bgeo file that ends before its points do");
        mAt += bytes;
    }

    double next(char kind, unsigned bytes)
    {
        const char* const first = mBytes.data() + mAt;
        skip(bytes);
        return *numberAt(first, {kind, bytes}, true);
    }

    void skipText() { skip(static_cast<std::uint64_t>(next('u', 2))); }

    // The number of its values: floats, integers or vectors with a default each, or strings by their number
    // in a list.
    std::uint64_t readAttribute()
    {
        skipText(); // its name
        const auto size = static_cast<std::uint64_t>(next('u', 2));
        const double type = next('i', 4);
        if (type == 0 || type == 1 || type == 5) {
            skip(4 * size);
        } else if (type == 4) {
            for (double left = next('i', 4); left > 0; --left) skipText();
        } else {
            mInput.fail("has a .bgeo attribute of a type that is not known");
        }
        return size;
    }

    const PointInput& mInput;
    const std::string mBytes;
    std::size_t mAt = 0;
};

} // namespace

Positions readBgeoPoints(const PointInput& input)
{
    return BgeoFile(input).read();
}

} // namespace vdb_nns::cli

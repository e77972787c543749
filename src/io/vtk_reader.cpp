// The reader of VTK's legacy format, versions 1.0 to 5.1. A file is five parts: `# vtk DataFile Version x.y`,
// a title line, ASCII or BINARY, DATASET with its kind, and sections. What is read is the section POINTS;
// those before it are walked over. Nothing behind the points is read, but a section or the end of the file
// has to begin there.
//
//   DATASET POLYDATA
//   FIELD FieldData 1            name, components, tuples and type of each array, and then its values
//   TIME 1 1 double
//   (8 bytes)
//   POINTS 24 float
//   (288 bytes)
//
// Binary values are big-endian; text is numbers with spaces or line ends between. Keywords may be in either
// case.
#include "io/fixed_rows.h"
#include "io/vtk_walk.h"
#include "util/memory.h"

#include <oneapi/tbb/parallel_for.h>

namespace vdb_nns {

namespace {

constexpr std::size_t kChunkBytes = std::size_t(1) << 20;

// Whether a section or the end of the file begins there, behind spaces.
bool isSectionEnd(const VtkWalk& walk, const ArrayFile& file, std::size_t at)
{
    at = walk.skipSpacesFrom(at);
    return at == file.bytes.size() || isWord(walk.wordAt(at));
}

PositionArray readBinaryPoints(const ArrayFile& file, const VtkWalk& walk, std::uint64_t count,
                               const std::string& typeName, NumberType type)
{
    const std::uint64_t left = file.bytes.size() - walk.next;
    // The shorter one first: in the middle of longer values begins no section.
    std::vector<NumberType> types;
    if (typeName == "long") types.push_back(NumberType::kInt32);
    if (typeName == "unsigned_long") types.push_back(NumberType::kUInt32);
    types.push_back(type);
    for (const NumberType tried : types) {
        const std::size_t size = sizeOf(tried), rowBytes = 3 * size;
        if (count > left / rowBytes) continue;
        if (!isSectionEnd(walk, file, walk.next + static_cast<std::size_t>(count) * rowBytes)) continue;
        return readFixedRows(file, {walk.next,
                                    rowBytes,
                                    static_cast<std::size_t>(count),
                                    {{{0, tried}, {size, tried}, {2 * size, tried}}},
                                    true});
    }
    const std::uint64_t rowBytes = 3 * sizeOf(type);
    if (count > left / rowBytes) {
        walk.failAt(walk.next, "POINTS promises " + std::to_string(count) + " points of " +
                                   std::to_string(rowBytes) + " bytes, but only " + std::to_string(left) +
                                   " bytes follow; the file is truncated");
    }
    const std::size_t end = walk.next + static_cast<std::size_t>(count * rowBytes);
    walk.failAt(end, "expected a section or the end of the file behind the " + std::to_string(count) +
                         " points of type " + typeName + ", found '" + shownText(walk.wordAt(end)) + "'; " +
                         std::to_string(file.bytes.size() - end) + " bytes are left over");
}

// Text from the first value on: cut at spaces into chunks, whose values are counted, so that each chunk knows
// the number of its first one, and then read in parallel.
class TextPoints {
public:
    TextPoints(const ArrayFile& file, const VtkWalk& walk, std::uint64_t count, NumberType type)
        : mFile(file),
          mWalk(walk),
          mCount(count),
          mType(type),
          mBegin(reinterpret_cast<const char*>(file.bytes.data())),
          mEnd(mBegin + file.bytes.size())
    {
    }

    PositionArray read()
    {
        cutIntoChunks();
        forEachChunk([](Chunk& chunk) {
            for (const char* next = skip(chunk.begin, chunk.end); next != chunk.end; ++chunk.values)
                next = skip(endOfToken(next, chunk.end), chunk.end);
        });
        std::uint64_t values = 0;
        for (Chunk& chunk : mChunks) {
            chunk.first = values;
            values += chunk.values;
        }
        if (mCount > values / 3) {
            mWalk.failAt(mFile.bytes.size(), "POINTS promises " + std::to_string(mCount) +
                                                 " points, but only " + std::to_string(values) +
                                                 " values follow; the file is truncated");
        }
        checkPointCount(mFile, mCount, mType != NumberType::kFloat);
        PositionArray result;
        if (mType == NumberType::kFloat) {
            readValues(result.floats);
        } else {
            readValues(result.doubles);
        }
        return result;
    }

private:
    struct Chunk {
        const char* begin;
        const char* end;
        std::uint64_t values, first;
        std::string fault;
        std::size_t faultByte;
    };

    static const char* skip(const char* next, const char* end)
    {
        while (next != end && isTextSpace(*next)) ++next;
        return next;
    }

    void cutIntoChunks()
    {
        for (const char* begin = mBegin + mWalk.next; begin != mEnd;) {
            const char* cut = mEnd;
            if (static_cast<std::size_t>(mEnd - begin) > kChunkBytes)
                cut = endOfToken(begin + kChunkBytes, mEnd);
            mChunks.push_back({begin, cut, 0, 0, {}, 0});
            begin = cut;
        }
    }

    template <typename Use>
    void forEachChunk(const Use& use)
    {
        tbb::parallel_for(std::size_t(0), mChunks.size(), [&](std::size_t i) {
            mFile.cancel.check();
            use(mChunks[i]);
        });
    }

    template <typename Real>
    void readValues(std::vector<Real>& out)
    {
        const std::uint64_t needed = 3 * mCount;
        resizeOnHugePages(out, static_cast<std::size_t>(needed));
        forEachChunk([&](Chunk& chunk) { readChunk(chunk, needed, out.data()); });
        for (const Chunk& chunk : mChunks) {
            if (!chunk.fault.empty()) mWalk.failAt(chunk.faultByte, chunk.fault);
        }
    }

    template <typename Real>
    void readChunk(Chunk& chunk, std::uint64_t needed, Real* out) const
    {
        std::uint64_t number = chunk.first;
        for (const char* next = skip(chunk.begin, chunk.end); next != chunk.end && number <= needed;
             ++number) {
            const char* const token = next;
            const auto fail = [&](const std::string& what) {
                const char* const end = endOfToken(token, chunk.end);
                chunk.fault = "'" + shownText({token, static_cast<std::size_t>(end - token)}) + "' " + what;
                chunk.faultByte = static_cast<std::size_t>(token - mBegin);
            };
            if (number == needed) { // a section, or a value too much
                if (!isWord(mWalk.wordAt(static_cast<std::size_t>(token - mBegin)))) {
                    fail("stands behind the " + std::to_string(needed) + " values that POINTS promises; " +
                         std::to_string(mEnd - token) + " bytes are left over");
                }
                return;
            }
            if (const char* const what = readTextNumber(mType, next, chunk.end, out[number])) {
                return fail(std::string(what) + "; it stands in the place of value " +
                            std::to_string(number + 1) + " of the " + std::to_string(needed) +
                            " that POINTS promises");
            }
            next = skip(next, chunk.end);
        }
    }

    const ArrayFile& mFile;
    const VtkWalk& mWalk;
    const std::uint64_t mCount;
    const NumberType mType;
    const char* const mBegin;
    const char* const mEnd;
    std::vector<Chunk> mChunks;
};

} // namespace

ReadArray parseVtk(const ArrayFile& file)
{
    VtkWalk walk(file);
    walk.readHead();
    std::string typeName;
    const std::uint64_t count = walk.findPoints(typeName);
    const NumberType type = walk.typeNamed(typeName, walk.next);
    ReadArray result;
    result.positions = walk.isBinary ? readBinaryPoints(file, walk, count, typeName, type)
                                     : TextPoints(file, walk, count, type).read();
    if (!isReal(type)) result.taken = "POINTS of type " + typeName;
    return result;
}

} // namespace vdb_nns

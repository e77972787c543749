// Bodies of binary .ply files. Rows of one width are converted in parallel; where a row holds lists, it is
// walked over.
#include "io/fixed_rows.h"
#include "io/ply_body.h"

#include <algorithm>

namespace vdb_nns {

namespace {

constexpr std::uint64_t kUnlimitedRows = std::numeric_limits<std::uint64_t>::max();
// Rows that may be looked at in the search for values that the header does not declare: some tenths of a
// second.
constexpr std::uint64_t kSearchedRows = std::uint64_t(1) << 24;
constexpr std::uint64_t kMostHiddenBytes = 64; // of a row: eight doubles

// Steps over rows. `what` says why it stopped early, at byte `next`.
class RowWalk {
public:
    RowWalk(const PlyBody& body, std::size_t next)
        : next(next),
          mBytes(body.file.bytes),
          mCancel(body.file.cancel),
          mIsBigEndian(body.header.format == PlyFormat::kBigEndian)
    {
    }

    std::size_t next;
    const char* what = nullptr;
    std::uint64_t rowsLeft = kUnlimitedRows;   // that may be walked over one by one
    std::uint64_t indexLimit = kUnlimitedRows; // less: lists have values, and faces vertices of such numbers

    bool skipElement(const PlyElement& element)
    {
        const std::uint64_t rowBytes = element.minRowBytes(PlyFormat::kLittleEndian);
        if (rowBytes == 0) return true;
        if (!element.hasLists()) {
            if (element.count > (mBytes.size() - next) / rowBytes) return stop(kTruncated);
            next += static_cast<std::size_t>(element.count * rowBytes);
            return true;
        }
        for (std::uint64_t row = 0; row < element.count; ++row) {
            if (rowsLeft-- == 0) return stop("too many rows");
            if (row % kRowsBetween == 0) mCancel.check();
            for (const PlyProperty& property : element.properties) {
                if (!skipProperty(property)) return false;
            }
        }
        return true;
    }

    bool skipProperty(const PlyProperty& property)
    {
        if (!property.isList) return skipBytes(sizeOf(property.type));
        const std::size_t start = next;
        if (!skipBytes(sizeOf(property.countType))) return false;
        const std::int64_t length = withNumberType(property.countType, [&](auto zero) {
            return static_cast<std::int64_t>(loadNumber<decltype(zero)>(mBytes.data() + start, mIsBigEndian));
        });
        if (length >= 0) {
            const std::size_t first = next;
            return skipBytes(static_cast<std::uint64_t>(length) * sizeOf(property.type)) && // < 2^35
                   (indexLimit == kUnlimitedRows || isPlausible(property, first, length));
        }
        next = start;
        return stop("the length of a list is negative");
    }

    template <typename Real>
    bool readValue(NumberType type, Real& out)
    {
        const std::size_t start = next;
        if (!skipBytes(sizeOf(type))) return false;
        withNumberType(type, [&](auto zero) {
            out = static_cast<Real>(loadNumber<decltype(zero)>(mBytes.data() + start, mIsBigEndian));
        });
        return true;
    }

private:
    static constexpr std::uint64_t kRowsBetween = std::uint64_t(1) << 16;
    static constexpr const char* kTruncated =
        "the file ends before the rows that its header promises; it is truncated";

    bool stop(const char* why)
    {
        what = why;
        return false;
    }

    bool isPlausible(const PlyProperty& property, std::size_t first, std::int64_t length)
    {
        if (length == 0) return stop("a list is empty");
        if (property.name.compare(0, 10, "vertex_ind") != 0 || isReal(property.type)) return true;
        if (length < 3) return stop("a face has less than three vertices");
        return withNumberType(property.type, [&](auto zero) {
            for (std::int64_t i = 0; i < length; ++i) {
                const std::size_t at = first + static_cast<std::size_t>(i) * sizeof zero;
                const auto index = loadNumber<decltype(zero)>(mBytes.data() + at, mIsBigEndian);
                if (index < zero || static_cast<std::uint64_t>(index) >= indexLimit)
                    return stop("a face has a vertex that is not there");
            }
            return true;
        });
    }

    bool skipBytes(std::uint64_t count)
    {
        if (count > mBytes.size() - next) return stop(kTruncated);
        next += static_cast<std::size_t>(count);
        return true;
    }

    FileBytes mBytes;
    const CancelCheck& mCancel;
    bool mIsBigEndian;
};

class BinaryBody {
public:
    explicit BinaryBody(const PlyBody& body) : mBody(body), mFile(body.file), mVertex(body.vertexElement()) {}

    ReadArray read()
    {
        RowWalk walk(mBody, mBody.header.bytes);
        for (std::size_t i = 0; i < mBody.vertex; ++i) {
            if (!walk.skipElement(mBody.header.elements[i])) failAt(mFile.path, walk.next, walk.what);
        }
        const std::size_t begin = walk.next;
        const std::uint64_t rowBytes = mVertex.minRowBytes(mBody.header.format);
        const std::uint64_t left = mFile.bytes.size() - begin;
        if (mVertex.count > left / rowBytes) {
            throw InputError(mFile.path + ": the .ply header promises " + std::to_string(mVertex.count) +
                             " of element 'vertex' with at least " + std::to_string(rowBytes) +
                             " bytes each, but from byte " + std::to_string(begin) +
                             " on the file has only " + std::to_string(left) +
                             "; it is truncated or its header is wrong");
        }
        ReadArray result;
        if (!mVertex.hasLists()) {
            walk.next += static_cast<std::size_t>(mVertex.count * rowBytes);
            checkLaterElements(walk.next, begin, result);
            const FixedRows rows = fixedRows(begin, static_cast<std::size_t>(rowBytes));
            if (mBody.width() == 1) {
                result.positions.doubles = readFixedColumn(mFile, rows, rows.columns[0]);
            } else {
                result.positions = readFixedRows(mFile, rows);
            }
            return result;
        }
        checkPointCount(mFile, mVertex.count, mBody.isDouble, mBody.width());
        if (mBody.isDouble) {
            readRows(walk, result.positions.doubles);
        } else {
            readRows(walk, result.positions.floats);
        }
        checkLaterElements(walk.next, begin, result);
        return result;
    }

private:
    FixedRows fixedRows(std::size_t begin, std::size_t rowBytes) const
    {
        FixedRows rows{begin,
                       rowBytes,
                       static_cast<std::size_t>(mVertex.count),
                       {},
                       mBody.header.format == PlyFormat::kBigEndian};
        for (std::size_t k = 0; k < mBody.width(); ++k) {
            for (std::size_t i = 0; i < mBody.property[k]; ++i)
                rows.columns[k].offset += sizeOf(mVertex.properties[i].type);
            rows.columns[k].type = mBody.read(k).type;
        }
        return rows;
    }

    template <typename Real>
    void readRows(RowWalk& walk, std::vector<Real>& out) const
    {
        const std::size_t width = mBody.width();
        std::vector<std::size_t> placeOf(mVertex.properties.size(), width); // width: none
        for (std::size_t k = 0; k < width; ++k) placeOf[mBody.property[k]] = k;
        out.resize(static_cast<std::size_t>(mVertex.count) * width);
        for (std::size_t row = 0; row < mVertex.count; ++row) {
            if (row % 65536 == 0) mFile.cancel.check();
            for (std::size_t i = 0; i < placeOf.size(); ++i) {
                const PlyProperty& property = mVertex.properties[i];
                const bool isThere = placeOf[i] < width
                                         ? walk.readValue(property.type, out[width * row + placeOf[i]])
                                         : walk.skipProperty(property);
                if (!isThere) failAt(mFile.path, walk.next, walk.what);
            }
        }
    }

    bool skipLaterElements(RowWalk& walk) const
    {
        for (std::size_t i = mBody.vertex + 1; i < mBody.header.elements.size(); ++i) {
            if (!walk.skipElement(mBody.header.elements[i])) return false;
        }
        return true;
    }

    void checkLaterElements(std::size_t end, std::size_t begin, ReadArray& result) const
    {
        RowWalk walk(mBody, end);
        const bool isWhole = skipLaterElements(walk);
        if (isWhole && walk.next == mFile.bytes.size()) return;
        if (mBody.vertex + 1 == mBody.header.elements.size()) failLeftOver(end, begin, surplusHint(end));
        const std::string hidden = findHiddenValues(begin, end);
        if (!hidden.empty() || isWhole) failLeftOver(hidden.empty() ? walk.next : end, begin, hidden);
        result.notes.push_back(forgivenNote(mBody, walk.what, "byte " + std::to_string(walk.next)));
    }

    // What is too much, if the elements behind the vertices do not end where the file does, but would if each
    // vertex held some bytes more, or if there were more of them.
    std::string findHiddenValues(std::size_t begin, std::size_t end) const
    {
        if (mVertex.count == 0 || mVertex.hasLists()) return {};
        const std::uint64_t left = mFile.bytes.size() - end, rowBytes = (end - begin) / mVertex.count;
        std::uint64_t rowsLeft = kSearchedRows;
        const auto fits = [&](std::uint64_t bytes, std::uint64_t vertices) {
            RowWalk walk(mBody, end + static_cast<std::size_t>(bytes));
            walk.rowsLeft = rowsLeft;
            walk.indexLimit = vertices;
            const bool isWhole = skipLaterElements(walk) && walk.next == mFile.bytes.size();
            rowsLeft = walk.rowsLeft == kUnlimitedRows ? 0 : walk.rowsLeft - (walk.rowsLeft > 0);
            return isWhole;
        };
        const auto rowsMore = [&](std::uint64_t bytes) {
            return ", counting " + std::to_string(bytes / rowBytes) + " rows more";
        };
        const std::uint64_t mostHidden = std::min(kMostHiddenBytes, left / mVertex.count);
        for (std::uint64_t hidden = 1; hidden <= mostHidden && rowsLeft > 0; ++hidden) {
            const std::uint64_t bytes = hidden * mVertex.count;
            if (!fits(bytes, mVertex.count)) continue;
            if (bytes % rowBytes == 0) return rowsMore(bytes);
            return ", counting " + std::to_string(hidden) +
                   " for each vertex, as if rows held more properties";
        }
        for (std::uint64_t bytes = rowBytes; bytes <= left && rowsLeft > 0; bytes += rowBytes) {
            if (fits(bytes, mVertex.count + bytes / rowBytes)) return rowsMore(bytes);
        }
        return {};
    }

    // The same where no element follows.
    std::string surplusHint(std::size_t end) const
    {
        if (mVertex.count == 0 || mVertex.hasLists()) return {};
        const std::uint64_t left = mFile.bytes.size() - end,
                            rowBytes = mVertex.minRowBytes(mBody.header.format);
        if (left % rowBytes == 0) return ", as many as " + std::to_string(left / rowBytes) + " rows more";
        if (left % mVertex.count != 0) return {};
        return ", " + std::to_string(left / mVertex.count) +
               " for each vertex, as if rows held more properties";
    }

    [[noreturn]] void failLeftOver(std::size_t end, std::size_t begin, const std::string& hint) const
    {
        throw InputError(mFile.path + ": " + std::to_string(mFile.bytes.size() - end) +
                         " bytes are left over behind the last row, from byte " + std::to_string(end) +
                         " on" + hint + ": the .ply header declares " + std::to_string(mVertex.count) +
                         " rows of element 'vertex' of " + (mVertex.hasLists() ? "at least " : "") +
                         std::to_string(mVertex.minRowBytes(mBody.header.format)) + " bytes from byte " +
                         std::to_string(begin) +
                         " on; write a header that declares all there is, or copy the file again");
    }

    const PlyBody& mBody;
    const ArrayFile& mFile;
    const PlyElement& mVertex;
};

} // namespace

ReadArray readPlyBinary(const PlyBody& body)
{
    return BinaryBody(body).read();
}

} // namespace vdb_nns

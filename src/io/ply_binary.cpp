// Bodies of binary .ply files. Rows of one width are converted in parallel; where a row holds lists, it is walked over.
#include "io/fixed_rows.h"
#include "io/ply_body.h"

#include <optional>

namespace vdb_nns {

namespace {

constexpr std::uint64_t kUnlimitedRows = std::numeric_limits<std::uint64_t>::max();
// Rows that may be looked at in the search for values that the header does not declare: some tenths of a second.
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
    std::uint64_t rowsLeft = kUnlimitedRows; // that may be walked over one by one

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
        if (length >= 0)
            return skipBytes(static_cast<std::uint64_t>(length) * sizeOf(property.type)); // < 2^35
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
            result.positions = readFixedRows(mFile, fixedRows(begin, static_cast<std::size_t>(rowBytes)));
            return result;
        }
        checkPointCount(mFile, mVertex.count, mBody.isDouble);
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
        for (std::size_t k = 0; k < 3; ++k) {
            for (std::size_t i = 0; i < mBody.property[k]; ++i)
                rows.columns[k].offset += sizeOf(mVertex.properties[i].type);
            rows.columns[k].type = mBody.coordinate(k).type;
        }
        return rows;
    }

    template <typename Real>
    void readRows(RowWalk& walk, std::vector<Real>& out) const
    {
        std::vector<std::size_t> coordinate(mVertex.properties.size(), 3); // 3: none
        for (std::size_t k = 0; k < 3; ++k) coordinate[mBody.property[k]] = k;
        out.resize(static_cast<std::size_t>(mVertex.count) * 3);
        for (std::size_t row = 0; row < mVertex.count; ++row) {
            if (row % 65536 == 0) mFile.cancel.check();
            for (std::size_t i = 0; i < coordinate.size(); ++i) {
                const PlyProperty& property = mVertex.properties[i];
                const bool isThere = coordinate[i] < 3
                                         ? walk.readValue(property.type, out[3 * row + coordinate[i]])
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
        if (skipLaterElements(walk)) {
            if (walk.next != mFile.bytes.size()) failLeftOver(walk.next, begin);
            return;
        }
        if (const std::optional<std::string> hidden = findHiddenValues(begin, end)) {
            throw InputError(mFile.path + ": " + *hidden +
                             " than the .ply header declares; element 'vertex' begins at byte " +
                             std::to_string(begin) + "; write a header that declares all there is");
        }
        result.notes.push_back(forgivenNote(mBody, walk.what, "byte " + std::to_string(walk.next)));
    }

    // What is too much a row, if the elements behind the vertices do not end where the file does, but would if each vertex
    // held some bytes more, or if there were more of them.
    std::optional<std::string> findHiddenValues(std::size_t begin, std::size_t end) const
    {
        const std::uint64_t left = mFile.bytes.size() - end;
        std::uint64_t rowsLeft = kSearchedRows;
        const auto fits = [&](std::uint64_t bytes) {
            RowWalk walk(mBody, end + static_cast<std::size_t>(bytes));
            walk.rowsLeft = rowsLeft;
            const bool isWhole = skipLaterElements(walk) && walk.next == mFile.bytes.size();
            rowsLeft = walk.rowsLeft == kUnlimitedRows ? 0 : walk.rowsLeft - (walk.rowsLeft > 0);
            return isWhole;
        };
        if (mVertex.count == 0 || mVertex.hasLists()) return std::nullopt;
        for (std::uint64_t hidden = 1;
             hidden <= kMostHiddenBytes && hidden <= left / mVertex.count && rowsLeft > 0; ++hidden) {
            if (fits(hidden * mVertex.count))
                return "each row of element 'vertex' holds " + std::to_string(hidden) + " bytes more";
        }
        const std::uint64_t rowBytes = (end - begin) / mVertex.count;
        for (std::uint64_t rows = 1; rows <= left / rowBytes && rowsLeft > 0; ++rows) {
            if (fits(rows * rowBytes)) return "element 'vertex' has " + std::to_string(rows) + " rows more";
        }
        return std::nullopt;
    }

    [[noreturn]] void failLeftOver(std::size_t end, std::size_t begin) const
    {
        const std::uint64_t left = mFile.bytes.size() - end;
        const std::uint64_t rowBytes = mVertex.minRowBytes(mBody.header.format);
        std::string hint;
        if (mVertex.count > 0 && !mVertex.hasLists() && left % rowBytes == 0) {
            hint = ", as many as " + std::to_string(left / rowBytes) + " rows more";
        } else if (mVertex.count > 0 && left % mVertex.count == 0) {
            hint = ", " + std::to_string(left / mVertex.count) +
                   " for each vertex, as if rows held more properties";
        }
        throw InputError(mFile.path + ": " + std::to_string(left) +
                         " bytes are left over behind the last row, from byte " + std::to_string(end) +
                         " on" + hint + ": the .ply header declares " + std::to_string(mVertex.count) +
                         " rows of element 'vertex' of " + (mVertex.hasLists() ? "at least " : "") +
                         std::to_string(rowBytes) + " bytes from byte " + std::to_string(begin) +
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

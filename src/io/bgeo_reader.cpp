// The reader of Houdini's classic .bgeo, version 5, plain or compressed with gzip as Partio and SPlisHSPlasH
// write it. All numbers are big-endian:
//
//   'Bgeo' 'V' int32 5
//   int32 points, primitives, point groups, primitive groups,
//         attributes of points, of vertices, of primitives, of the whole
//   for each attribute of points: uint16 length and name, uint16 size, int32 type, and then
//       0 float, 1 int, 5 vector: `size` default values of 4 bytes
//       4 indexed string: int32 count of strings, each with uint16 length
//   for each point: float x, y, z, w, and the values of its attributes, 4 bytes each
//
// What is read is x, y and z. As in Partio, they are not divided by w, the weight of a spline's control
// point. Of what follows the points only the end is checked, where the header declares nothing but points:
// 0x00 0xff, or nothing.
#include "io/fixed_rows.h"

#include "vdb_nns/error.h"

#include <zlib.h>

#include <algorithm>

namespace vdb_nns {

namespace {

constexpr std::size_t kHeaderBytes = 41;
constexpr std::uint64_t kMostExpansion = 1032; // of deflate

class BgeoReader {
public:
    explicit BgeoReader(const ArrayFile& file) : mFile(file) {}

    ReadArray read()
    {
        checkMagic();
        const std::uint64_t points = count("points", 9);
        const bool hasMore = count("primitives", 13) + count("point groups", 17) +
                                 count("primitive groups", 21) + count("attributes of the whole", 37) >
                             0;
        const std::uint64_t attributes = count("attributes of points", 25);
        mNext = kHeaderBytes;
        std::uint64_t rowBytes = 16;
        for (std::uint64_t i = 0; i < attributes; ++i) rowBytes += 4 * readAttribute();
        const std::uint64_t left = mFile.bytes.size() - mNext;
        if (points > left / rowBytes) {
            fail(mNext, "the header promises " + std::to_string(points) + " points of " +
                            std::to_string(rowBytes) + " bytes, but only " + std::to_string(left) +
                            " bytes follow; the file is truncated");
        }
        const std::size_t end = mNext + static_cast<std::size_t>(points * rowBytes);
        if (!hasMore) checkEnd(end);
        ReadArray result;
        const NumberType real = NumberType::kFloat;
        result.positions = readFixedRows(mFile, {mNext,
                                                 static_cast<std::size_t>(rowBytes),
                                                 static_cast<std::size_t>(points),
                                                 {{{0, real}, {4, real}, {8, real}}},
                                                 true});
        noteWeights(static_cast<std::size_t>(points), static_cast<std::size_t>(rowBytes), result);
        return result;
    }

private:
    [[noreturn]] void fail(std::size_t byte, const std::string& what) const
    {
        throw InputError(mFile.path + ": damaged or unsupported .bgeo at byte " + std::to_string(byte) +
                         ": " + what);
    }

    template <typename Number>
    Number at(std::size_t byte) const
    {
        if (byte > mFile.bytes.size() || sizeof(Number) > mFile.bytes.size() - byte)
            fail(mFile.bytes.size(), "the file ends inside of its header; it is truncated");
        return loadNumber<Number>(mFile.bytes.data() + byte, true);
    }

    bool beginsWith(std::string_view magic) const
    {
        return mFile.bytes.size() >= magic.size() &&
               std::memcmp(mFile.bytes.data(), magic.data(), magic.size()) == 0;
    }

    void checkMagic() const
    {
        if (beginsWith("\x7fNSJ")) {
            throw InputError(
                mFile.path +
                ": is the .bgeo of Houdini 12 and later (binary JSON), which is not read; save it as "
                ".bhclassic and name that .bgeo, or as .ply");
        }
        if (beginsWith("scf1")) {
            throw InputError(
                mFile.path +
                ": is compressed with Blosc (.bgeo.sc), which is not read; save it from Houdini as "
                ".bhclassic and name that .bgeo, or as .ply");
        }
        if (!beginsWith("BgeoV")) {
            throw InputError(
                mFile.path +
                ": is not a classic .bgeo file: it does not begin with 'BgeoV', plain or compressed "
                "with gzip, but with '" +
                shownText({reinterpret_cast<const char*>(mFile.bytes.data()),
                           std::min(mFile.bytes.size(), std::size_t(5))}) +
                "'; docs/formats.md says how to convert other files");
        }
        const auto version = at<std::int32_t>(5);
        if (version != 5)
            fail(5, "version " + std::to_string(version) + " is not 5; save it from Houdini as .bhclassic");
    }

    std::uint64_t count(const char* what, std::size_t byte) const
    {
        const auto value = at<std::int32_t>(byte);
        if (value < 0) fail(byte, "the number of " + std::string(what) + " is " + std::to_string(value));
        return static_cast<std::uint64_t>(value);
    }

    template <typename Number>
    Number take()
    {
        const Number value = at<Number>(mNext);
        mNext += sizeof value;
        return value;
    }

    void skip(std::uint64_t bytes)
    {
        if (bytes > mFile.bytes.size() - mNext)
            fail(mNext, "the file ends inside of its attributes; it is truncated");
        mNext += static_cast<std::size_t>(bytes);
    }

    // Returns the values that a point has of it.
    std::uint64_t readAttribute()
    {
        const std::size_t begin = mNext;
        const std::uint64_t nameBytes = take<std::uint16_t>();
        const std::size_t name = mNext;
        skip(nameBytes);
        const std::uint64_t size = take<std::uint16_t>();
        const auto type = take<std::int32_t>();
        if (type == 0 || type == 1 || type == 5) {
            skip(4 * size);
        } else if (type == 4) {
            const std::uint64_t strings = count("strings", mNext);
            mNext += 4;
            for (std::uint64_t i = 0; i < strings; ++i) skip(take<std::uint16_t>());
        } else {
            fail(begin, "attribute '" +
                            shownText({reinterpret_cast<const char*>(mFile.bytes.data()) + name, nameBytes}) +
                            "' has type " + std::to_string(type) + (type == 2 ? " (string)" : "") +
                            ", which is not read; remove it before saving");
        }
        return size;
    }

    void checkEnd(std::size_t end) const
    {
        const std::size_t left = mFile.bytes.size() - end;
        if (left == 0) return;
        const unsigned char* const rest = mFile.bytes.data() + end;
        if (left >= 2 && rest[0] == 0 && rest[left - 1] == 0xFF) return;
        fail(end, std::to_string(left) +
                      " bytes are left over behind the last point, where the header declares nothing; "
                      "copy or write the file again");
    }

    void noteWeights(std::size_t points, std::size_t rowBytes, ReadArray& result) const
    {
        std::size_t weighted = 0;
        const unsigned char* const first = mFile.bytes.data() + mNext;
        for (std::size_t i = 0; i < points; ++i) {
            if (i % 65536 == 0) mFile.cancel.check();
            weighted += loadNumber<float>(first + i * rowBytes + 12, true) != 1;
        }
        if (weighted == 0) return;
        result.notes.push_back(std::to_string(weighted) +
                               " points have a weight w that is not 1; x, y and z were taken as they are");
    }

    const ArrayFile& mFile;
    std::size_t mNext = 0;
};

// The members of a gzip file, put together. Its checksums are checked.
std::vector<unsigned char> gunzip(const ArrayFile& file)
{
    constexpr std::size_t kPiece = std::size_t(64) << 20; // zlib counts in 32 bits
    constexpr int kGzip = 16;
    const FileBytes from = file.bytes;
    z_stream stream{};
    if (::inflateInit2(&stream, MAX_WBITS + kGzip) != Z_OK) throw std::bad_alloc();
    struct End {
        z_stream* stream;
        ~End() { ::inflateEnd(stream); }
    } const end{&stream};
    // The last four bytes are the size, modulo 2^32, of the last member, which is most often the only one.
    const std::uint64_t hint =
        from.size() < 18 ? 0 : loadNumber<std::uint32_t>(from.data() + from.size() - 4, false);
    std::vector<unsigned char> out(
        static_cast<std::size_t>(std::min({hint, kMostExpansion * from.size(), file.allowedBytes})) + 64);
    std::size_t taken = 0, made = 0;
    const auto fail = [&] {
        throw InputError(file.path + ": the gzip file is damaged or truncated at byte " +
                         std::to_string(taken) + "; copy it again");
    };
    while (taken < from.size()) {
        file.cancel.check();
        checkPointsFit(file.path, made, file.allowedBytes);
        if (made == out.size()) out.resize(2 * out.size());
        const std::size_t in = std::min(kPiece, from.size() - taken),
                          room = std::min(kPiece, out.size() - made);
        stream.next_in = const_cast<unsigned char*>(from.data() + taken);
        stream.avail_in = static_cast<uInt>(in);
        stream.next_out = out.data() + made;
        stream.avail_out = static_cast<uInt>(room);
        const int status = ::inflate(&stream, Z_NO_FLUSH);
        taken += in - stream.avail_in;
        made += room - stream.avail_out;
        if (status == Z_STREAM_END) {
            if (taken == from.size()) {
                out.resize(made);
                return out;
            }
            if (::inflateReset(&stream) != Z_OK) fail();
        } else if (status != Z_OK && !(status == Z_BUF_ERROR && stream.avail_out == 0)) {
            fail();
        }
    }
    // The input is at its end, but output may be left.
    fail();
    return {};
}

} // namespace

ReadArray parseBgeo(const ArrayFile& file)
{
    const bool isGzip =
        file.bytes.size() >= 2 && file.bytes.data()[0] == 0x1F && file.bytes.data()[1] == 0x8B;
    if (!isGzip) return BgeoReader(file).read();
    const std::vector<unsigned char> bytes = gunzip(file);
    const std::uint64_t held = bytes.size();
    checkPointsFit(file.path, held, file.allowedBytes);
    ReadArray result =
        BgeoReader(
            {file.path, {bytes.data(), bytes.size()}, file.choice, file.allowedBytes - held, file.cancel})
            .read();
    return result;
}

} // namespace vdb_nns

// Named arrays into an .npz, and positions into an .npz or .npy: pieces of each array go to their places in parallel.
#include "io/npz_parts.h"
#include "io/npz_writer.h"
#include "io/output_file.h"
#include "io/value_names.h"
#include "io/world_positions.h"
#include "points/value_check.h"
#include "util/cancel.h"
#include "util/isolate.h"
#include "vdb_nns/error.h"
#include "vdb_nns/write_points.h"

#include <oneapi/tbb/enumerable_thread_specific.h>
#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

namespace vdb_nns {

namespace {

// Bytes that are written at once; their checksum is made while they are in the second-level cache.
constexpr std::size_t kPieceBytes = std::size_t(1) << 20;
// A directory without ZIP64 counts members in 16 bits.
constexpr std::size_t kMostMembers = 65534;

// Rows of an array, as they are in memory or made of positions.
struct Rows {
    const void* values = nullptr; // null: positions
    std::uint64_t count = 0;
    std::size_t rowBytes = 0;
};

const char* descrOf(AttributeType type)
{
    switch (type) {
    case AttributeType::kFloat:
    case AttributeType::kVec3s:
    case AttributeType::kMat3s:
        return "<f4";
    case AttributeType::kDouble:
    case AttributeType::kVec3d:
        return "<f8";
    case AttributeType::kInt32:
        return "<i4";
    case AttributeType::kInt64:
        return "<i8";
    }
    return "";
}

std::string shapeOf(std::uint64_t count, std::size_t width)
{
    const std::string rows = std::to_string(count);
    return width == 1 ? rows + "," : width == 3 ? rows + ", 3" : rows + ", 3, 3";
}

// Writes rows of arrays, by all threads.
class RowWriter {
public:
    RowWriter(OutputFile& file, const WorldPositions* positions, bool isDouble, std::uint64_t totalBytes,
              const CancelCheck& cancel)
        : mFile(file), mPositions(positions), mIsDouble(isDouble), mTotalBytes(totalBytes), mCancel(cancel)
    {
    }

    // Returns the CRC of what was written.
    std::uint32_t write(std::uint64_t offset, const Rows& rows)
    {
        const std::size_t pieceRows = std::max<std::size_t>(1, kPieceBytes / rows.rowBytes);
        const std::size_t pieces = static_cast<std::size_t>((rows.count + pieceRows - 1) / pieceRows);
        std::vector<std::uint32_t> crcs(pieces);
        tbb::parallel_for(std::size_t(0), pieces, [&](std::size_t piece) {
            mCancel.update(static_cast<double>(mWrittenBytes) / static_cast<double>(mTotalBytes + 1));
            const std::size_t begin = piece * pieceRows;
            const std::size_t count = std::min(pieceRows, static_cast<std::size_t>(rows.count) - begin);
            const std::size_t bytes = count * rows.rowBytes;
            const void* const values = rows.values
                                           ? static_cast<const char*>(rows.values) + begin * rows.rowBytes
                                           : positionRows(begin, count);
            crcs[piece] = crcOf(0, values, bytes);
            mFile.writeAt(offset + begin * rows.rowBytes, values, bytes);
            mWrittenBytes += bytes;
        });
        std::uint32_t crc = 0;
        for (std::size_t piece = 0; piece < pieces; ++piece) {
            const std::uint64_t left = rows.count - std::uint64_t(piece) * pieceRows;
            crc = crcJoined(crc, crcs[piece], std::min<std::uint64_t>(pieceRows, left) * rows.rowBytes);
        }
        return crc;
    }

private:
    const void* positionRows(std::size_t begin, std::size_t count)
    {
        Buffers& buffers = mBuffers.local();
        buffers.doubles.resize(3 * count);
        mPositions->read(begin, count, buffers.doubles.data());
        if (mIsDouble) return buffers.doubles.data();
        buffers.floats.resize(3 * count);
        std::transform(buffers.doubles.begin(), buffers.doubles.end(), buffers.floats.begin(),
                       [](double value) { return static_cast<float>(value); });
        return buffers.floats.data();
    }

    struct Buffers {
        std::vector<double> doubles;
        std::vector<float> floats;
    };

    OutputFile& mFile;
    const WorldPositions* mPositions;
    const bool mIsDouble;
    const std::uint64_t mTotalBytes;
    const CancelCheck& mCancel;
    std::atomic<std::uint64_t> mWrittenBytes{0};
    tbb::enumerable_thread_specific<Buffers> mBuffers;
};

// An .npz that is laid out before anything is written.
struct NpzArrays {
    std::vector<NpzMember> members;
    std::vector<Rows> rows;

    void add(const std::string& name, const char* descr, std::size_t width, const Rows& array)
    {
        members.push_back(npzMember(name, descr, shapeOf(array.count, width), array.count * array.rowBytes));
        rows.push_back(array);
    }

    void add(const PointValues& values)
    {
        for (const PointAttribute& attribute : values.attributes)
            add(attribute.name, descrOf(attribute.type), attributeWidth(attribute.type),
                {attribute.values.get(), attribute.count, attributeBytes(attribute.type)});
        for (const PointGroup& group : values.groups)
            add(group.name, "|b1", 1, {group.members.get(), group.count, 1});
    }
};

// Bools of NumPy are 1 or 0, members of groups 0 or not.
PointValues withPlainGroups(const PointValues& values)
{
    PointValues result = values;
    for (PointGroup& group : result.groups) {
        const std::uint8_t* const members = group.members.get();
        const auto isPlain = [](std::uint8_t member) { return member <= 1; };
        if (std::all_of(members, members + group.count, isPlain)) continue;
        const auto plain = std::make_shared<std::vector<std::uint8_t>>(static_cast<std::size_t>(group.count));
        std::transform(members, members + group.count, plain->begin(),
                       [](std::uint8_t member) { return std::uint8_t(member != 0); });
        group.members = {plain, plain->data()};
    }
    return result;
}

void writeNpzFile(const std::string& path, NpzArrays& arrays, const WorldPositions* positions, bool isDouble,
                  const OutputOptions& output, const CancelCheck& cancel)
{
    if (arrays.members.size() > kMostMembers)
        throw InvalidInput(path + ": " + std::to_string(arrays.members.size()) +
                           " arrays are more than an .npz holds here (" + std::to_string(kMostMembers) + ")");
    const std::uint64_t end = placeMembers(arrays.members.data(), arrays.members.size());
    const std::uint64_t bytes =
        end + centralDirectory(arrays.members.data(), arrays.members.size(), end).size();
    OutputFile file(path, output);
    file.requireRoom(bytes);
    file.reserve(0, bytes);
    RowWriter writer(file, positions, isDouble, bytes, cancel);
    for (std::size_t i = 0; i < arrays.members.size(); ++i) {
        NpzMember& member = arrays.members[i];
        member.crc = crcOf(0, member.npyHeader.data(), member.npyHeader.size());
        if (arrays.rows[i].count > 0)
            member.crc =
                crcJoined(member.crc, writer.write(member.valueOffset, arrays.rows[i]), member.valueBytes);
        const std::string header = localHeader(member);
        file.writeAt(member.localOffset, header.data(), header.size());
    }
    const std::string directory = centralDirectory(arrays.members.data(), arrays.members.size(), end);
    file.writeAt(end, directory.data(), directory.size());
    cancel.update(1);
    file.commit();
}

WrittenPoints factsOf(const WorldPositions& positions, const CancelCheck& cancel)
{
    const PositionFacts facts = positions.measure(cancel);
    WrittenPoints written;
    written.points = positions.size();
    written.isDouble = !facts.areFloats;
    written.largestRounding = facts.largestRounding;
    return written;
}

} // namespace

WrittenPoints writePointsNpz(const std::string& path, const ParticleView& view, const PointValues& values,
                             const OutputOptions& output, Progress* progress)
{
    return isolatedIeee([&] {
        const CancelCheck cancel(progress, "write");
        cancel.update(0);
        checkValues(path + ": ", values, view.size());
        ValueNames(PointFormat::kNpz).addAll(path, values);
        const WorldPositions positions(view);
        const WrittenPoints written = factsOf(positions, cancel);
        const std::size_t rowBytes = 3 * (written.isDouble ? sizeof(double) : sizeof(float));
        const PointValues plain = withPlainGroups(values);
        NpzArrays arrays;
        arrays.add("positions", written.isDouble ? "<f8" : "<f4", 3, {nullptr, positions.size(), rowBytes});
        arrays.add(plain);
        writeNpzFile(path, arrays, &positions, written.isDouble, output, cancel);
        return written;
    });
}

void writeArraysNpz(const std::string& path, const PointValues& values, const OutputOptions& output,
                    Progress* progress)
{
    isolatedIeee([&] {
        const CancelCheck cancel(progress, "write");
        cancel.update(0);
        std::uint64_t count = 0;
        if (!values.attributes.empty()) count = values.attributes.front().count;
        if (values.attributes.empty() && !values.groups.empty()) count = values.groups.front().count;
        checkValues(path + ": ", values, count);
        ValueNames(PointFormat::kNpz, {}, /*hasPositions=*/false).addAll(path, values);
        const PointValues plain = withPlainGroups(values);
        NpzArrays arrays;
        arrays.add(plain);
        writeNpzFile(path, arrays, nullptr, false, output, cancel);
    });
}

WrittenPoints writePointsNpy(const std::string& path, const ParticleView& view, const OutputOptions& output,
                             Progress* progress)
{
    return isolatedIeee([&] {
        const CancelCheck cancel(progress, "write");
        cancel.update(0);
        const WorldPositions positions(view);
        const WrittenPoints written = factsOf(positions, cancel);
        const std::size_t rowBytes = 3 * (written.isDouble ? sizeof(double) : sizeof(float));
        const std::string header = npyHeader(written.isDouble ? "<f8" : "<f4", shapeOf(positions.size(), 3));
        const std::uint64_t bytes = header.size() + positions.size() * rowBytes;
        OutputFile file(path, output);
        file.requireRoom(bytes);
        file.reserve(0, bytes);
        file.writeAt(0, header.data(), header.size());
        RowWriter writer(file, &positions, written.isDouble, bytes, cancel);
        writer.write(header.size(), {nullptr, positions.size(), rowBytes});
        cancel.update(1);
        file.commit();
        return written;
    });
}

} // namespace vdb_nns

// The .ply writer: a header, and rows of one width, which all threads write to their places.
#include "io/number_type.h"
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
#include <cstring>
#include <string>
#include <vector>

namespace vdb_nns {

namespace {

// Rows of a task: each write is about a megabyte.
constexpr std::size_t kTaskRows = std::size_t(1) << 14;

const char* typeName(AttributeType type)
{
    switch (type) {
    case AttributeType::kFloat:
    case AttributeType::kVec3s:
    case AttributeType::kMat3s:
        return "float";
    case AttributeType::kInt32:
        return "int";
    case AttributeType::kDouble:
    case AttributeType::kVec3d:
    case AttributeType::kInt64: // the format has none of 64 bits
        return "double";
    }
    return "";
}

std::string headerText(std::size_t rows, bool isDouble, const PointValues& values)
{
    std::string text = "ply\nformat binary_little_endian 1.0\nelement vertex " + std::to_string(rows) + "\n";
    const auto declare = [&](const char* type, const std::string& name) {
        text += std::string("property ") + type + " " + name + "\n";
    };
    for (const char* axis : {"x", "y", "z"}) declare(isDouble ? "double" : "float", axis);
    for (const PointAttribute& attribute : values.attributes) {
        for (const std::string& name : plyProperties(attribute.name, attribute.type))
            declare(typeName(attribute.type), name);
    }
    for (const PointGroup& group : values.groups) declare("uchar", group.name);
    return text + "end_header\n";
}

// Values of `bytes` each into rows.
void putColumn(const void* values, std::size_t bytes, std::size_t count, std::size_t rowBytes, char* out)
{
    const char* next = static_cast<const char*>(values);
    for (std::size_t i = 0; i < count; ++i, next += bytes, out += rowBytes) std::memcpy(out, next, bytes);
}

class PlyRows {
public:
    PlyRows(const std::string& path, const WorldPositions& positions, bool isDouble,
            const PointValues& values)
        : mPath(path), mPositions(positions), mIsDouble(isDouble), mValues(values)
    {
        mRowBytes = 3 * (isDouble ? sizeof(double) : sizeof(float)) + values.groups.size();
        for (const PointAttribute& attribute : values.attributes) mRowBytes += attributeBytes(attribute.type);
    }

    std::size_t rowBytes() const { return mRowBytes; }

    void write(OutputFile& file, std::uint64_t offset, const CancelCheck& cancel)
    {
        const std::size_t tasks = (mPositions.size() + kTaskRows - 1) / kTaskRows;
        std::atomic<std::size_t> done{0};
        tbb::parallel_for(std::size_t(0), tasks, [&](std::size_t task) {
            cancel.update(static_cast<double>(done) / static_cast<double>(tasks));
            const std::size_t begin = task * kTaskRows;
            const std::size_t count = std::min(kTaskRows, mPositions.size() - begin);
            std::vector<char>& rows = mBuffers.local().rows;
            rows.resize(count * mRowBytes);
            fill(begin, count, rows.data());
            file.writeAt(offset + std::uint64_t(begin) * mRowBytes, rows.data(), rows.size());
            ++done;
        });
    }

private:
    struct Buffers {
        std::vector<char> rows;
        std::vector<double> doubles;
        std::vector<float> floats;
    };

    void fill(std::size_t begin, std::size_t count, char* out)
    {
        Buffers& buffers = mBuffers.local();
        std::vector<double>& doubles = buffers.doubles;
        doubles.resize(3 * count);
        mPositions.read(begin, count, doubles.data());
        if (mIsDouble) {
            putColumn(doubles.data(), 3 * sizeof(double), count, mRowBytes, out);
            out += 3 * sizeof(double);
        } else {
            buffers.floats.resize(3 * count);
            std::transform(doubles.begin(), doubles.end(), buffers.floats.begin(),
                           [](double value) { return static_cast<float>(value); });
            putColumn(buffers.floats.data(), 3 * sizeof(float), count, mRowBytes, out);
            out += 3 * sizeof(float);
        }
        for (const PointAttribute& attribute : mValues.attributes) {
            const std::size_t bytes = attributeBytes(attribute.type);
            const char* const values = static_cast<const char*>(attribute.values.get()) + begin * bytes;
            if (attribute.type == AttributeType::kInt64) {
                putIntegers(attribute, begin, count, out);
            } else {
                putColumn(values, bytes, count, mRowBytes, out);
            }
            out += bytes;
        }
        for (const PointGroup& group : mValues.groups) {
            const std::uint8_t* const members = group.members.get() + begin;
            for (std::size_t i = 0; i < count; ++i) out[i * mRowBytes] = static_cast<char>(members[i] != 0);
            ++out;
        }
    }

    void putIntegers(const PointAttribute& attribute, std::size_t begin, std::size_t count, char* out) const
    {
        const auto* const values = static_cast<const std::int64_t*>(attribute.values.get());
        for (std::size_t i = begin; i < begin + count; ++i, out += mRowBytes) {
            if (!isExactInDouble(values[i])) {
                throw InputError(mPath + ": attribute '" + attribute.name + "' of point " +
                                 std::to_string(i) + " is " + std::to_string(values[i]) +
                                 ", which no double holds exactly, and a .ply has no integers of 64 bits; "
                                 "leave the attribute out (--keep), or write .npz or .vdb");
            }
            const auto value = static_cast<double>(values[i]);
            std::memcpy(out, &value, sizeof value);
        }
    }

    const std::string& mPath;
    const WorldPositions& mPositions;
    const bool mIsDouble;
    const PointValues& mValues;
    std::size_t mRowBytes;
    tbb::enumerable_thread_specific<Buffers> mBuffers;
};

} // namespace

WrittenPoints writePly(const std::string& path, const ParticleView& view, const PointValues& values,
                       const OutputOptions& output, Progress* progress)
{
    return isolatedIeee([&] {
        const CancelCheck cancel(progress, "write");
        cancel.update(0);
        checkValues(path + ": ", values, view.size());
        ValueNames(PointFormat::kPly).addAll(path, values);
        const WorldPositions positions(view);
        const PositionFacts facts = positions.measure(cancel);
        WrittenPoints written;
        written.points = positions.size();
        written.isDouble = !facts.areFloats;
        written.largestRounding = facts.largestRounding;
        PlyRows rows(path, positions, written.isDouble, values);
        const std::string header = headerText(positions.size(), written.isDouble, values);
        const std::uint64_t bytes = header.size() + std::uint64_t(positions.size()) * rows.rowBytes();
        OutputFile file(path, output);
        file.requireRoom(bytes);
        file.reserve(0, bytes);
        file.writeAt(0, header.data(), header.size());
        rows.write(file, header.size(), cancel);
        cancel.update(1);
        file.commit();
        return written;
    });
}

} // namespace vdb_nns

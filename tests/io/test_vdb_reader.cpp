// Our reader of .vdb files against OpenVDB's: files of every kind, value for value.
#include "grid/sparse_grid_data.h"
#include "io/vdb/archive.h"
#include "io/vdb/grid_header.h"
#include "io/vdb/point_layout.h"
#include "io/vdb/point_reader.h"
#include "points/particle_source.h"
#include "support/memory_bytes.h"
#include "support/vdb_cases.h"
#include "vdb_nns/error.h"
#include "vdb_nns/point_file.h"

#include <openvdb/io/File.h>
#include <openvdb/io/Stream.h>
#include <openvdb/openvdb.h>
#include <openvdb/points/AttributeArrayString.h>
#include <openvdb/points/PointDataGrid.h>

#include <gtest/gtest.h>
#include <oneapi/tbb/global_control.h>
#include <oneapi/tbb/task_arena.h>

#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <map>
#include <optional>
#include <set>
#include <sstream>

#include <unistd.h>

namespace vdb_nns::testing {

namespace {

namespace fs = std::filesystem;
namespace points = openvdb::points;
using points::PointDataGrid;
using Leaf = points::PointDataTree::LeafNodeType;

const CancelCheck kNoCancel(nullptr, "test");

std::string contents(const std::string& path)
{
    std::ifstream in(path, std::ios::binary);
    std::ostringstream text;
    text << in.rdbuf();
    return text.str();
}

// The grids of a file as OpenVDB reads them, in the order of the file. `labels`: as our reader has them.
std::vector<openvdb::GridBase::Ptr> readByOpenVdb(const std::string& path, bool hasOffsets,
                                                  const std::vector<std::string>& labels)
{
    std::vector<openvdb::GridBase::Ptr> grids;
    if (!hasOffsets) {
        std::ifstream in(path, std::ios::binary);
        openvdb::io::Stream stream(in, false);
        return *stream.getGrids();
    }
    openvdb::io::File file(path);
    file.open(false);
    std::multiset<std::string> names;
    for (auto name = file.beginName(); name != file.endName(); ++name) names.insert(*name);
    EXPECT_EQ(names, std::multiset<std::string>(labels.begin(), labels.end()));
    for (const std::string& label : labels) grids.push_back(file.readGrid(label));
    return grids;
}

void compareHeaders(const VdbGridHeader& header, const openvdb::GridBase& grid)
{
    std::size_t compared = 0;
    for (auto item = grid.beginMeta(); item != grid.endMeta(); ++item, ++compared) {
        const VdbMetadata* const ours = header.find(item->first);
        ASSERT_NE(ours, nullptr) << item->first;
        EXPECT_EQ(ours->type, item->second->typeName()) << item->first;
        std::ostringstream sized(std::ios::binary);
        item->second->write(sized);
        EXPECT_EQ(ours->value, sized.str().substr(4)) << item->first;
    }
    // OpenVDB takes away what says where the values lie that it may load later.
    EXPECT_EQ(header.metadata.size() - (header.find("file_delayed_load") ? 1 : 0), compared);

    const VdbTransform& ours = header.transform;
    const openvdb::math::Transform& theirs = grid.transform();
    EXPECT_EQ(ours.mapType, theirs.mapType());
    EXPECT_EQ(ours.isLinear, theirs.isLinear());
    if (!ours.isLinear) return;
    const openvdb::math::Mat4d matrix = theirs.baseMap()->getAffineMap()->getMat4();
    for (int row = 0; row < 3; ++row) {
        for (int column = 0; column < 3; ++column)
            EXPECT_EQ(ours.linear[row][column], matrix[column][row]) << row << " " << column;
        EXPECT_EQ(ours.translation[row], matrix[3][row]) << row;
        EXPECT_EQ(ours.voxelSize[row], theirs.voxelSize()[row]) << row;
    }
}

void compareVolumeTypes(const VdbEntry& entry, const openvdb::GridBase& grid)
{
    EXPECT_EQ(entry.gridType, grid.type());
    EXPECT_EQ(entry.savesHalf, grid.saveFloatAsHalf());
}

// The values of an attribute in a leaf, by OpenVDB's handles, one after the other; strided ones too.
template <typename T>
std::string valuesOf(const points::AttributeArray& array, std::size_t count)
{
    const points::AttributeHandle<T> handle(array);
    std::string bytes;
    for (std::size_t i = 0; i < count; ++i) {
        const T value = handle.get(static_cast<openvdb::Index>(i));
        bytes.append(reinterpret_cast<const char*>(&value), sizeof value);
    }
    return bytes;
}

using Values = std::string (*)(const points::AttributeArray&, std::size_t);

const std::map<std::string, Values>& valuesOfTypes()
{
    using namespace openvdb::math;
    static const std::map<std::string, Values> types = {
        {"bool", valuesOf<bool>},          {"int8", valuesOf<std::int8_t>},
        {"uint8", valuesOf<std::uint8_t>}, {"int16", valuesOf<std::int16_t>},
        {"int32", valuesOf<std::int32_t>}, {"uint32", valuesOf<std::uint32_t>},
        {"int64", valuesOf<std::int64_t>}, {"float", valuesOf<float>},
        {"double", valuesOf<double>},      {"vec3i", valuesOf<Vec3<std::int32_t>>},
        {"vec3s", valuesOf<Vec3<float>>},  {"vec3d", valuesOf<Vec3<double>>},
        {"quats", valuesOf<Quat<float>>},  {"quatd", valuesOf<Quat<double>>},
        {"mat3s", valuesOf<Mat3<float>>},  {"mat3d", valuesOf<Mat3<double>>},
        {"mat4s", valuesOf<Mat4<float>>},  {"mat4d", valuesOf<Mat4<double>>}};
    return types;
}

std::vector<const Leaf*> leavesOf(const PointDataGrid& grid)
{
    std::vector<const Leaf*> leaves;
    for (auto leaf = grid.tree().cbeginLeaf(); leaf; ++leaf) leaves.push_back(&*leaf);
    return leaves;
}

std::size_t countOf(const Leaf& leaf)
{
    return static_cast<std::uint32_t>(leaf.getLastValue());
}

// Points as OpenVDB has them, in the form in which we read them.
struct ExpectedPoints {
    std::vector<Vec3i> leaves;
    std::vector<std::uint64_t> starts{0};
    std::vector<std::uint16_t> voxels;
    std::string positions;
};

ExpectedPoints expectedPoints(const std::vector<const Leaf*>& leaves)
{
    ExpectedPoints expected;
    for (const Leaf* const leaf : leaves) {
        if (countOf(*leaf) == 0) continue;
        const openvdb::Coord origin = leaf->origin();
        expected.leaves.push_back({origin[0], origin[1], origin[2]});
        expected.starts.push_back(expected.starts.back() + countOf(*leaf));
        std::uint32_t point = 0;
        for (openvdb::Index n = 0; n < Leaf::SIZE; ++n) {
            for (const std::uint32_t end = leaf->getValue(n); point < end; ++point)
                expected.voxels.push_back(static_cast<std::uint16_t>(n));
        }
        expected.positions += valuesOf<openvdb::Vec3f>(leaf->constAttributeArray("P"), countOf(*leaf));
    }
    return expected;
}

std::string bytesOf(const PageArray<float>& array)
{
    return std::string(reinterpret_cast<const char*>(array.data()), array.usedBytes());
}

void comparePoints(const GridPoints& ours, const ExpectedPoints& expected)
{
    EXPECT_EQ(ours.leaves, expected.leaves);
    EXPECT_EQ(ours.starts, expected.starts);
    EXPECT_EQ(std::vector<std::uint16_t>(ours.voxels.begin(), ours.voxels.end()), expected.voxels);
    EXPECT_TRUE(bytesOf(ours.positions) == expected.positions);
}

// What OpenVDB has of an attribute: the values of all leaves, or why ours does not read them.
struct ExpectedAttribute {
    std::string bytes;
    bool isRefused = false;
};

ExpectedAttribute expectedAttribute(const std::vector<const Leaf*>& leaves, const std::string& name)
{
    ExpectedAttribute expected;
    std::string type;
    for (const Leaf* const leaf : leaves) {
        const points::AttributeArray* const array = leaf->attributeSet().getConst(name);
        if (!array || countOf(*leaf) == 0) continue;
        expected.isRefused |= (!type.empty() && type != array->valueType()) || array->codecType() == "uvec" ||
                              array->stride() != 1 || !array->hasConstantStride();
        type = array->valueType();
    }
    if (expected.isRefused) return expected;
    // Where a leaf lacks the attribute, zeros stand for its values.
    const std::string codec = type == "uint32" ? "str" : type == "uint8" ? "grp" : "null";
    const std::size_t valueBytes = attributeType(type, codec).bytes();
    for (const Leaf* const leaf : leaves) {
        const points::AttributeArray* const array = leaf->attributeSet().getConst(name);
        if (countOf(*leaf) == 0) continue;
        expected.bytes += array ? valuesOfTypes().at(type)(*array, countOf(*leaf))
                                : std::string(valueBytes * countOf(*leaf), '\0');
    }
    return expected;
}

std::string bytesOf(const VdbValues& values)
{
    return std::string(static_cast<const char*>(values.bytes.data()),
                       static_cast<std::size_t>(values.count) * values.type.bytes());
}

// A grid of a file, read by both.
class Comparison {
public:
    Comparison(const ByteSource& file, const VdbDirectory& directory, const VdbEntry& entry,
               const PointDataGrid& grid)
        : mLeaves(leavesOf(grid))
    {
        const VdbEntry* const parent = parentOf(file, directory, entry);
        const VdbEntry& tree = parent ? *parent : entry;
        VdbCursor cursor(file, tree.gridBegin, tree.gridEnd);
        mLayout = readPointLayout(cursor, readGridHeader(cursor).compression);
        EXPECT_EQ(cursor.left(), 0u);
        mReader.emplace(file, mLayout, gridText(tree.uniqueName));
    }

    void compareAll()
    {
        ASSERT_EQ(mLayout.leaves.size(), mLeaves.size());
        compareDescriptors();
        const ExpectedPoints expected = expectedPoints(mLeaves);
        for (const int threads : {4, 1}) {
            GridPoints points;
            tbb::task_arena(threads).execute([&] { mReader->readPoints(all(), kNoCancel, points); });
            comparePoints(points, expected);
            for (const std::string& name : attributeNames())
                tbb::task_arena(threads).execute([&] { compareAttribute(name, points); });
        }
        compareGroups();
        for (const std::size_t k : {1, 2, 3})
            compareRange(mLeaves.size() * k / 7, mLeaves.size() * (k + 3) / 7);
        compareRange(0, mLeaves.size() / 2);
        compareRange(mLeaves.size(), mLeaves.size());
    }

private:
    VdbLeafRange all() const { return {0, mLayout.leaves.size()}; }

    std::set<std::string> attributeNames() const
    {
        std::set<std::string> names;
        for (const Leaf* const leaf : mLeaves) {
            for (const auto& [name, place] : leaf->attributeSet().descriptor().map()) names.insert(name);
        }
        return names;
    }

    void compareDescriptors() const
    {
        for (std::size_t i = 0; i < mLeaves.size(); ++i) {
            const Leaf& leaf = *mLeaves[i];
            const openvdb::Coord origin = leaf.origin();
            ASSERT_EQ(mLayout.leaves[i], (Vec3i{origin[0], origin[1], origin[2]}));
            const auto& theirs = leaf.attributeSet().descriptor();
            const VdbDescriptor& ours = mLayout.descriptor(i);
            ASSERT_EQ(ours.attributes.size(), theirs.size());
            for (const auto& [name, place] : theirs.map()) {
                EXPECT_EQ(ours.attributes[place].name, name);
                EXPECT_EQ(ours.attributes[place].valueType, theirs.valueType(place));
                EXPECT_EQ(ours.attributes[place].codec, theirs.type(place).second);
            }
            EXPECT_EQ(ours.groups, (std::map<std::string, std::uint64_t>(theirs.groupMap().begin(),
                                                                         theirs.groupMap().end())));
            compareTexts(leaf, ours);
        }
    }

    static void compareTexts(const Leaf& leaf, const VdbDescriptor& ours)
    {
        for (const VdbDescriptor::Attribute& attribute : ours.attributes) {
            const points::AttributeArray& array = leaf.constAttributeArray(attribute.name);
            if (!points::isString(array) || !array.hasConstantStride()) continue;
            const points::StringAttributeHandle texts(array, leaf.attributeSet().descriptor().getMetadata());
            const points::AttributeHandle<std::uint32_t> numbers(array);
            for (std::size_t i = 0; i < countOf(leaf); ++i) {
                const auto point = static_cast<openvdb::Index>(i);
                const auto text = ours.texts.find(numbers.get(point));
                EXPECT_EQ(text == ours.texts.end() ? "" : text->second, texts.get(point));
            }
        }
    }

    void compareAttribute(const std::string& name, const GridPoints& points) const
    {
        const ExpectedAttribute expected = expectedAttribute(mLeaves, name);
        try {
            const VdbValues values = mReader->readAttribute(all(), name, points, kNoCancel);
            EXPECT_FALSE(expected.isRefused) << name;
            EXPECT_TRUE(bytesOf(values) == expected.bytes) << name;
        } catch (const InputError& e) {
            EXPECT_TRUE(expected.isRefused) << e.what();
            EXPECT_NE(std::string(e.what()).find("attribute '" + name + "'"), std::string::npos) << e.what();
        }
    }

    // Membership, by the bits of the arrays that hold it.
    void compareGroups() const
    {
        if (mLeaves.empty()) return;
        GridPoints points;
        mReader->readPoints(all(), kNoCancel, points);
        for (const auto& [group, bit] : mLayout.descriptor(0).groups) {
            std::vector<std::string> arrays;
            for (const VdbDescriptor::Attribute& attribute : mLayout.descriptor(0).attributes) {
                if (attribute.codec == "grp") arrays.push_back(attribute.name);
            }
            ASSERT_LT(bit / 8, arrays.size());
            const std::string bytes =
                bytesOf(mReader->readAttribute(all(), arrays[bit / 8], points, kNoCancel));
            std::size_t next = 0;
            for (const Leaf* const leaf : mLeaves) {
                const points::GroupHandle handle = leaf->groupHandle(group);
                for (std::size_t i = 0; i < countOf(*leaf); ++i) {
                    ASSERT_EQ(bytes[next++] >> (bit % 8) & 1,
                              handle.get(static_cast<openvdb::Index>(i)) ? 1 : 0);
                }
            }
        }
    }

    // A range of leaves has what they have when they are alone.
    void compareRange(std::size_t begin, std::size_t end) const
    {
        const std::vector<const Leaf*> leaves(mLeaves.begin() + static_cast<std::ptrdiff_t>(begin),
                                              mLeaves.begin() + static_cast<std::ptrdiff_t>(end));
        GridPoints points;
        mReader->readPoints({begin, end}, kNoCancel, points);
        comparePoints(points, expectedPoints(leaves));
        for (const std::string& name : attributeNames()) {
            const ExpectedAttribute expected = expectedAttribute(leaves, name);
            if (expected.isRefused) continue;
            const VdbValues values = mReader->readAttribute({begin, end}, name, points, kNoCancel);
            EXPECT_TRUE(bytesOf(values) == expected.bytes) << name;
        }
    }

    std::vector<const Leaf*> mLeaves;
    VdbPointLayout mLayout;
    std::optional<VdbPointReader> mReader;
};

// The file of a user: the same points as a view.
void comparePointFile(const std::string& path, const std::string& label, const PointDataGrid& grid)
{
    PointFileOptions options;
    options.grid = label;
    if (!grid.transform().isLinear()) {
        EXPECT_THROW(PointFile::read(path, options), InputError);
        return;
    }
    const PointFile file = PointFile::read(path, options);
    const PointFileInfo& info = file.info();
    EXPECT_EQ(info.grid, grid.getName());
    const std::vector<const Leaf*> leaves = leavesOf(grid);
    const ExpectedPoints expected = expectedPoints(leaves);
    ASSERT_EQ(file.view().size(), expected.voxels.size());
    EXPECT_EQ(info.points, expected.voxels.size());
    std::size_t leaf = 0;
    for (std::size_t i = 0; i < expected.voxels.size(); ++i) {
        while (i >= expected.starts[leaf + 1]) ++leaf;
        const StoredPosition stored = file.view().stored(i);
        const int voxel = expected.voxels[i];
        const int in[3] = {voxel >> 6, voxel >> 3 & 7, voxel & 7};
        float position[3];
        std::memcpy(position, expected.positions.data() + i * sizeof position, sizeof position);
        for (int k = 0; k < 3; ++k) {
            ASSERT_EQ(stored.voxel[k], expected.leaves[leaf][k] + in[k]) << i;
            if (std::isnan(position[k])) {
                ASSERT_TRUE(std::isnan(stored.offset[k])) << i;
            } else {
                ASSERT_EQ(stored.offset[k], position[k]) << i;
            }
        }
    }
    const auto radius = grid.getMetadata<openvdb::DoubleMetadata>("suggested_radius");
    const auto single = grid.getMetadata<openvdb::FloatMetadata>("suggested_radius");
    ASSERT_EQ(info.suggestedRadius.has_value(), radius || single);
    if (info.suggestedRadius) {
        EXPECT_EQ(*info.suggestedRadius, radius ? radius->value() : double(single->value()));
    }
    for (const Leaf* const first : leaves) {
        const auto& descriptor = first->attributeSet().descriptor();
        if (descriptor.size() == 0) continue;
        EXPECT_EQ(info.codec, descriptor.type(descriptor.find("P")).second);
        ASSERT_EQ(info.attributes.size(), descriptor.size());
        for (const auto& [name, place] : descriptor.map()) EXPECT_EQ(info.attributes[place].name, name);
        break;
    }
}

class VdbReader : public ::testing::Test {
protected:
    VdbReader() : mThreads(tbb::global_control::max_allowed_parallelism, 4)
    {
        openvdb::initialize();
        mPath = (fs::path(::testing::TempDir()) / ("vdb_nns_reader_" + std::to_string(::getpid()) + ".vdb"))
                    .string();
    }
    ~VdbReader() override { fs::remove(mPath); }

    // Returns the number of points that were compared.
    std::size_t compare(const std::string& bytes)
    {
        std::ofstream(mPath, std::ios::binary) << bytes;
        const MemoryBytes file(bytes.data(), bytes.size());
        const VdbDirectory directory = readVdbDirectory(file);
        std::vector<std::string> labels;
        for (const VdbEntry& entry : directory.entries) labels.push_back(gridLabel(entry.uniqueName));
        const std::vector<openvdb::GridBase::Ptr> grids = readByOpenVdb(mPath, directory.hasOffsets, labels);
        EXPECT_EQ(grids.size(), labels.size());
        std::size_t count = 0;
        for (std::size_t i = 0; i < labels.size() && i < grids.size(); ++i) {
            SCOPED_TRACE("grid " + std::to_string(i) + " '" + labels[i] + "'");
            const VdbEntry& entry = directory.entries[i];
            compareVolumeTypes(entry, *grids[i]);
            VdbCursor cursor(file, entry.gridBegin, entry.gridEnd);
            compareHeaders(readGridHeader(cursor), *grids[i]);
            const auto points = openvdb::gridPtrCast<PointDataGrid>(grids[i]);
            if (!points) continue;
            Comparison(file, directory, entry, *points).compareAll();
            comparePointFile(mPath, labels[i], *points);
            for (const Leaf* const leaf : leavesOf(*points)) count += countOf(*leaf);
        }
        return count;
    }

    tbb::global_control mThreads; // more than this machine may have
    std::string mPath;
};

TEST_F(VdbReader, readsEveryKindAsOpenVdbDoes)
{
    for (const std::string& name : vdbCaseNames()) {
        SCOPED_TRACE(name);
        EXPECT_NO_THROW(compare(makeVdbCase(name)));
        if (HasFatalFailure()) return;
    }
}

TEST_F(VdbReader, readsRandomFilesAsOpenVdbDoes)
{
    std::size_t points = 0;
    for (std::uint32_t seed = 0; seed < 300; ++seed) {
        SCOPED_TRACE("seed " + std::to_string(seed));
        EXPECT_NO_THROW(points += compare(makeRandomVdb(seed)));
        if (HasFatalFailure()) return;
    }
    EXPECT_GT(points, 300u * 1000);
}

// Counts what is read.
class CountedBytes final : public ByteSource {
public:
    explicit CountedBytes(const ByteSource& file) : mFile(file)
    {
        mName = file.name();
        mSize = file.size();
    }

    void readAt(std::uint64_t offset, void* out, std::size_t bytes) const override
    {
        mBytesRead += bytes;
        mFile.readAt(offset, out, bytes);
    }

    std::uint64_t bytesRead() const { return mBytesRead; }

private:
    const ByteSource& mFile;
    mutable std::uint64_t mBytesRead = 0; // by one thread
};

// A directory is read in small parts: those of many small grids would else be read hundreds of times.
TEST_F(VdbReader, readsADirectoryOfManyGridsAFewTimesAtMost)
{
    const std::string bytes = makeManyInstances(3000);
    const MemoryBytes memory(bytes.data(), bytes.size());
    const CountedBytes file(memory);
    EXPECT_EQ(readVdbDirectory(file).entries.size(), 3001u);
    EXPECT_LT(file.bytesRead(), 60 * bytes.size());
}

TEST_F(VdbReader, readsFilesOfOtherVersionsAsOpenVdbDoes)
{
    for (const char* const name : {"openvdb13_dam_break_3000.vdb", "openvdb13_spray_fx16.vdb"}) {
        SCOPED_TRACE(name);
        // OpenVDB before 13 refuses their version, which says nothing of how a point grid is written.
        std::string bytes = contents(std::string(VDB_NNS_TEST_DATA "/") + name);
        ASSERT_EQ(bytes[kVdbVersionPosition], char(225));
        if (openvdb::OPENVDB_FILE_VERSION < 225) bytes[kVdbVersionPosition] = char(224);
        EXPECT_GT(compare(bytes), 1000u);
    }
}

} // namespace

} // namespace vdb_nns::testing

#include "lists_writer.h"

#include <boost/crc.hpp>

#include <fstream>
#include <stdexcept>

namespace vdb_nns::testing {

namespace {

std::string little(std::uint64_t value, int bytes)
{
    std::string text;
    for (int k = 0; k < bytes; ++k) text += static_cast<char>(value >> (8 * k) & 0xff);
    return text;
}

} // namespace

RawLists rawLists(const std::vector<std::vector<std::uint32_t>>& rows)
{
    RawLists lists;
    lists.offsets.push_back(0);
    for (const auto& row : rows) {
        lists.indices.insert(lists.indices.end(), row.begin(), row.end());
        lists.offsets.push_back(static_cast<std::int64_t>(lists.indices.size()));
    }
    return lists;
}

std::string npyBytes(const std::string& descr, const std::string& shape, const std::string& bytes)
{
    std::string header = "{'descr': '" + descr + "', 'fortran_order': False, 'shape': " + shape + ", }";
    while ((10 + header.size() + 1) % 64) header += ' ';
    header += '\n';
    return "\x93NUMPY" + std::string("\1\0", 2) + little(header.size(), 2) + header + bytes;
}

Members listMembers(const RawLists& lists)
{
    const auto shape = [](std::size_t n) { return "(" + std::to_string(n) + ",)"; };
    const std::size_t rows = lists.offsets.size() - 1, pairs = lists.indices.size();
    const std::size_t columns = lists.columns.value_or(rows);
    const std::string ones(pairs, '\1');
    return {
        {"indptr.npy", npyBytes("<i8", shape(rows + 1), bytesOf<std::int64_t>(lists.offsets))},
        {"indices.npy", npyBytes("<i4", shape(pairs), bytesOf<std::int32_t>(lists.indices))},
        {"data.npy", lists.distances.empty()
                         ? npyBytes("|i1", shape(pairs), ones)
                         : npyBytes("<f4", shape(lists.distances.size()), bytesOf<float>(lists.distances))},
        {"shape.npy",
         npyBytes("<i8", "(2,)", bytesOf<std::int64_t>(std::vector<std::size_t>{rows, columns}))},
        {"format.npy", npyBytes("|S3", "()", "csr")},
    };
}

std::string zipBytes(const Members& members)
{
    std::string file, directory;
    for (const auto& [name, bytes] : members) {
        boost::crc_32_type crc;
        crc.process_bytes(bytes.data(), bytes.size());
        // Version 2.0, no flags, stored, 1980-01-01 00:00; then CRC, both sizes, lengths of name and extra field.
        const std::string common = little(20, 2) + little(0, 2) + little(0, 2) + little(0, 2) +
                                   little(33, 2) + little(crc.checksum(), 4) + little(bytes.size(), 4) +
                                   little(bytes.size(), 4) + little(name.size(), 2) + little(0, 2);
        directory += little(0x02014b50, 4) + little(20, 2) + common + little(0, 2) + little(0, 8) +
                     little(file.size(), 4) + name;
        file += little(0x04034b50, 4) + common + name + bytes;
    }
    const std::string end = little(0x06054b50, 4) + little(0, 4) + little(members.size(), 2) +
                            little(members.size(), 2) + little(directory.size(), 4) + little(file.size(), 4) +
                            little(0, 2);
    return file + directory + end;
}

void writeBytes(const std::string& path, const std::string& bytes)
{
    std::ofstream stream(path, std::ios::binary);
    stream.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
    if (!stream) throw std::runtime_error("cannot write " + path);
}

} // namespace vdb_nns::testing

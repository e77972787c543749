// How lists that no memory holds become an .npz file: rows come in any order and go to their place in the file.
#pragma once

#include "io/npz_writer.h"
#include "vdb_nns/neighbor_lists.h"
#include "vdb_nns/point_file.h"

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

namespace vdb_nns {

// Makes rows when asked, and keeps none.
class NpzRowSource : public RowGeometry {
public:
    virtual std::uint64_t columnCount() const = 0;
    // Entries of each row; read once.
    virtual std::vector<std::uint32_t> counts() const = 0;
    virtual std::uint64_t pairCount() const = 0;
    // Hands out every row that is not empty, once, in any order, from several threads at once.
    virtual void visitRows(const NeighborLists::RowVisitor& visit, Progress* progress) const = 0;
};

// streamNpz() of point_file.h for rows of any origin. A thread collects `threadBytes` of rows before it writes them.
void streamNpzRows(const std::string& path, const NpzRowSource& source, const ListForm& form,
                   const OutputOptions& output, std::size_t threadBytes, Progress* progress);

} // namespace vdb_nns

#include "independent_search.h"

#include "row_check.h"
#include "row_pass.h"
#include "vdb_nns/error.h"

#include <string>

namespace vdb_nns::cli {

namespace {

void checkShape(const SearchTerms& terms, const ListsFile& lists)
{
    const std::size_t rows = terms.queries.view.size(), columns = terms.candidates.view.size();
    const std::string end = "; are these the lists of this file?";
    if (lists.rowCount() != rows) {
        throw InputError(lists.path() + ": has " + std::to_string(lists.rowCount()) +
                         " rows, but there are " + std::to_string(rows) +
                         (terms.isOneSet() ? " points" : " queries") + end);
    }
    if (lists.columnCount() != columns) {
        throw InputError(lists.path() + ": has " + std::to_string(lists.columnCount()) +
                         " columns, but there are " + std::to_string(columns) + " points" + end);
    }
}

} // namespace

VerifyReport verifyLists(const SearchTerms& terms, const ListsFile& lists, const VerifyOptions& options,
                         Progress* progress)
{
    checkRadius(terms);
    checkShape(terms, lists);
    const SearchJudge judge(terms);
    const RowPass<RowChecker> pass(judge, RowChecker(lists, judge, options.maxExamples));
    return pass.run({options.sample, options.seed}, {progress}).finish();
}

VerifyReport verifyLists(const ParticleView& view, double radius, const ListsFile& lists,
                         const VerifyOptions& options, Progress* progress)
{
    SearchTerms terms;
    terms.queries = terms.candidates = view;
    terms.radius = radius;
    return verifyLists(terms, lists, options, progress);
}

} // namespace vdb_nns::cli

// What bench says of a peer whose library was not there when it was built. This program has such a peer: its source is
// compiled into it once more, without what CMake tells of the library, and stands before that of the bench.
#include "bench/method_names.h"
#include "bench/methods/other_methods.h"
#include "bench/methods/peers.h"
#include "bench/stability/matrix.h"
#include "vdb_nns/error.h"

#include <gtest/gtest.h>

#include <string>

namespace vdb_nns::cli {
namespace {

std::string refusalOf(const std::string& methods)
{
    try {
        parseMethods(methods, {});
    } catch (const InvalidInput& refusal) {
        return refusal.what();
    }
    return {};
}

TEST(MissingPeer, IsNamedWithWhatToInstall)
{
    ASSERT_FALSE(hasNanoflann());
    for (const char* name : {"nanoflann-float", "nanoflann-double", "ours-index,nanoflann-double@1"}) {
        const std::string refusal = refusalOf(name);
        EXPECT_NE(refusal.find("nanoflann"), std::string::npos) << name << ": " << refusal;
        EXPECT_NE(refusal.find("install libnanoflann-dev and build again"), std::string::npos) << refusal;
    }
    ASSERT_FALSE(hasTreeNSearch());
    EXPECT_NE(refusalOf("treensearch").find("configure with -DVDB_NNS_TREENSEARCH=FOLDER and build again"),
              std::string::npos);
    for (const char* family : {"nanoflann-float", "treensearch"}) {
        MethodSpec spec;
        spec.name = spec.family = family;
        EXPECT_THROW(makePeerMethod(spec), InvalidInput);
    }
}

TEST(MissingPeer, IsLeftOutOfGroupsAndDefaults)
{
    const auto has = [](const std::vector<MethodSpec>& specs, const std::string& part) {
        for (const MethodSpec& spec : specs) {
            if (spec.name.find(part) != std::string::npos) return true;
        }
        return false;
    };
    for (const auto& specs : {parseMethods("peers", {}), parseMethods("", {}), stabilityMethods()}) {
        EXPECT_TRUE(has(specs, "openvdb"));
        EXPECT_FALSE(has(specs, "nanoflann"));
        EXPECT_FALSE(has(specs, "treensearch"));
    }
}

} // namespace
} // namespace vdb_nns::cli

// The device layer, whichever of its two definitions is linked: it says what it is, and without a device it says why.
#include "cuda/launch.h"
#include "vdb_nns/error.h"
#include "vdb_nns/version.h"

#include <gtest/gtest.h>

#include <string>

using namespace vdb_nns;

TEST(DeviceLayer, theLibraryReportsTheLayerThatIsLinked)
{
    EXPECT_STREQ(cudaBuild(), cuda::buildDescription());
    EXPECT_NE(std::string(buildInfo()).find(std::string("CUDA: ") + cuda::buildDescription()),
              std::string::npos);
}

TEST(DeviceLayer, withoutADeviceItThrowsASentence)
{
    try {
        const auto devices = cuda::listDevices();
        ASSERT_FALSE(devices.empty());
        for (std::size_t i = 0; i < devices.size(); ++i) {
            EXPECT_EQ(devices[i].ordinal, static_cast<int>(i));
            EXPECT_FALSE(devices[i].name.empty());
            EXPECT_GT(devices[i].totalBytes, 0u);
        }
    } catch (const DeviceError& error) {
        const std::string message = error.what();
        const bool stub = std::string(cuda::buildDescription()) == "absent";
        const auto says = [&](const char* words) { return message.find(words) != std::string::npos; };
        EXPECT_TRUE(stub ? says("built without CUDA")
                         : says("no NVIDIA driver") || says("from cudaGetDeviceCount"))
            << message;
    }
}

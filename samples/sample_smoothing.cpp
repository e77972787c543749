// A noisy velocity made smooth: each particle takes the mean of its neighbors' velocities, weighted by mass and by a kernel.
// `average` weighs by the kernel alone, so the momentum m v and the mass m are averaged, both in one pass, and then divided.
// Prints how far the velocity is from the one without noise, before and after.
#include <vdb_nns/measure.h>

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <random>
#include <vector>

namespace {

using Vec3f = std::array<float, 3>;

// A slow vortex about the z axis.
Vec3f vortex(const Vec3f& at)
{
    const float speed = std::exp(-(at[0] * at[0] + at[1] * at[1]));
    return {-at[1] * speed, at[0] * speed, 0.1f * speed};
}

struct Fluid {
    std::vector<Vec3f> position, velocity, momentum;
    std::vector<float> mass;
};

// Two fluids, water below and oil above, with a noise whose deviation goes as 1/sqrt(mass).
Fluid makeFluid(std::size_t count)
{
    Fluid fluid;
    std::mt19937 random(1);
    std::uniform_real_distribution<float> place(-1, 1);
    std::normal_distribution<float> noise(0, 0.1f);
    for (std::size_t i = 0; i < count; ++i) {
        const Vec3f at = {place(random), place(random), place(random)};
        const float mass = at[2] < 0 ? 1.0f : 0.4f;
        Vec3f velocity = vortex(at), momentum{};
        for (std::size_t c = 0; c < 3; ++c) {
            velocity[c] += noise(random) / std::sqrt(mass);
            momentum[c] = mass * velocity[c];
        }
        fluid.position.push_back(at);
        fluid.velocity.push_back(velocity);
        fluid.momentum.push_back(momentum);
        fluid.mass.push_back(mass);
    }
    return fluid;
}

// Root of the mean square of the difference from the vortex.
double error(const std::vector<Vec3f>& position, const std::vector<Vec3f>& velocity)
{
    double sum = 0;
    for (std::size_t i = 0; i < position.size(); ++i) {
        const Vec3f truth = vortex(position[i]);
        for (std::size_t c = 0; c < 3; ++c) sum += std::pow(velocity[i][c] - truth[c], 2);
    }
    return std::sqrt(sum / static_cast<double>(position.size()));
}

} // namespace

int main()
{
    const std::size_t count = 100000;
    const double radius = 0.12; // about 90 neighbors
    const Fluid fluid = makeFluid(count);
    const auto view = vdb_nns::ParticleView::fromArray(fluid.position[0].data(), count);

    vdb_nns::MeasureOptions options;
    options.kernel = vdb_nns::SmoothingKernel::kWendland2;
    options.attributes = {
        vdb_nns::viewAttribute("momentum", vdb_nns::AttributeType::kVec3s, fluid.momentum[0].data(), count),
        vdb_nns::viewAttribute("mass", vdb_nns::AttributeType::kFloat, fluid.mass.data(), count)};
    const vdb_nns::PointValues averages =
        vdb_nns::measure(view, radius, {"average:momentum", "average:mass"}, options);
    const float* const momentum = static_cast<const float*>(averages.attributes[0].values.get());
    const float* const mass = static_cast<const float*>(averages.attributes[1].values.get());

    std::vector<Vec3f> smooth(count);
    for (std::size_t i = 0; i < count; ++i)
        for (std::size_t c = 0; c < 3; ++c) smooth[i][c] = momentum[3 * i + c] / mass[i];

    const double before = error(fluid.position, fluid.velocity), after = error(fluid.position, smooth);
    std::printf("%zu particles; error of the velocity %.4f as it came, %.4f as an average: %.1f times less\n",
                count, before, after, before / after);
    return after < before / 3 ? 0 : 1;
}

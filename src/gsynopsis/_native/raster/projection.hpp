// The EWA projection of LANES Gaussians at once, as both directions need it.
#pragma once

#include "raster/raster.hpp"
#include "simd.hpp"

namespace gsyn {
namespace GSYN_VARIANT {

// The parameters of LANES Gaussians, one vector each.
struct Batch {
    Floats mean[3], quat[4], scale[3];
};

// Lane i gets rows[i][component] of an array of rows of `width` floats.
GSYN_INLINE Floats gather(const float *rows, int width, int component, const int64_t *index) {
    alignas(64) float lane[LANES];
    for (int i = 0; i < LANES; i++) lane[i] = rows[index[i] * width + component];
    return load(lane);
}

GSYN_INLINE Batch gather_batch(const Cloud &cloud, const int64_t *index) {
    Batch batch;
    for (int k = 0; k < 3; k++) batch.mean[k] = gather(cloud.means, 3, k, index);
    for (int k = 0; k < 4; k++) batch.quat[k] = gather(cloud.quats, 4, k, index);
    for (int k = 0; k < 3; k++) batch.scale[k] = gather(cloud.scales, 3, k, index);
    return batch;
}

struct Projection {
    Floats z, inverse_z;
    Floats u, v;                  // x/z and y/z
    Floats u_clamped, v_clamped;  // as the Jacobian takes them
    Floats quat[4], inverse_norm;
    Floats rotation[9];  // of the quaternion
    Floats shaped[9];    // rotation × scale
    Floats to_screen[6]; // Jacobian × world to camera, 2 × 3
    Floats spread[6];    // to_screen × shaped: the rows whose products are the covariance
    Floats xx, xy, yy;   // covariance, px², dilated
    Floats determinant;  // of it
    Floats own;          // determinant of the covariance with the Gaussian's own dilation only
};

GSYN_INLINE void rotation_of(const Floats *quat, Floats *matrix) {
    const Floats w = quat[0], x = quat[1], y = quat[2], z = quat[3];
    matrix[0] = 1.f - 2.f * (y * y + z * z);
    matrix[1] = 2.f * (x * y - w * z);
    matrix[2] = 2.f * (x * z + w * y);
    matrix[3] = 2.f * (x * y + w * z);
    matrix[4] = 1.f - 2.f * (x * x + z * z);
    matrix[5] = 2.f * (y * z - w * x);
    matrix[6] = 2.f * (x * z - w * y);
    matrix[7] = 2.f * (y * z + w * x);
    matrix[8] = 1.f - 2.f * (x * x + y * y);
}

GSYN_INLINE Projection project_batch(const Batch &g, const View &view) {
    Projection p;
    const float *R = view.rotation, *t = view.translation;
    Floats camera[3];
    for (int i = 0; i < 3; i++) {
        camera[i] = R[3 * i] * g.mean[0] + R[3 * i + 1] * g.mean[1] + R[3 * i + 2] * g.mean[2] + t[i];
    }
    p.z = camera[2];
    p.inverse_z = 1.f / p.z;
    p.u = camera[0] * p.inverse_z;
    p.v = camera[1] * p.inverse_z;
    const float u_limit = FOV_CLAMP * 0.5f * (float)view.width / view.fx;
    const float v_limit = FOV_CLAMP * 0.5f * (float)view.height / view.fy;
    p.u_clamped = clamp(p.u, -u_limit, u_limit);
    p.v_clamped = clamp(p.v, -v_limit, v_limit);

    Floats norm2{};
    for (int k = 0; k < 4; k++) norm2 += g.quat[k] * g.quat[k];
    p.inverse_norm = 1.f / root(norm2);
    for (int k = 0; k < 4; k++) p.quat[k] = g.quat[k] * p.inverse_norm;
    rotation_of(p.quat, p.rotation);
    for (int i = 0; i < 9; i++) p.shaped[i] = p.rotation[i] * g.scale[i % 3];

    const Floats x_by_x = view.fx * p.inverse_z, x_by_z = -x_by_x * p.u_clamped;
    const Floats y_by_y = view.fy * p.inverse_z, y_by_z = -y_by_y * p.v_clamped;
    for (int k = 0; k < 3; k++) {
        p.to_screen[k] = x_by_x * R[k] + x_by_z * R[6 + k];
        p.to_screen[3 + k] = y_by_y * R[3 + k] + y_by_z * R[6 + k];
    }
    for (int row = 0; row < 2; row++) {
        const Floats *T = p.to_screen + 3 * row;
        for (int k = 0; k < 3; k++) {
            p.spread[3 * row + k] =
                T[0] * p.shaped[k] + T[1] * p.shaped[3 + k] + T[2] * p.shaped[6 + k];
        }
    }
    const Floats *a = p.spread, *b = p.spread + 3;
    const Floats aa = a[0] * a[0] + a[1] * a[1] + a[2] * a[2];
    const Floats bb = b[0] * b[0] + b[1] * b[1] + b[2] * b[2];
    p.xx = aa + view.dilation;
    p.yy = bb + view.dilation;
    p.xy = a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    // xx yy − xy² loses everything for a long thin Gaussian; |a × b|² + dilation terms does not.
    const Floats c0 = a[1] * b[2] - a[2] * b[1];
    const Floats c1 = a[2] * b[0] - a[0] * b[2];
    const Floats c2 = a[0] * b[1] - a[1] * b[0];
    const Floats crossed = c0 * c0 + c1 * c1 + c2 * c2;
    p.determinant = crossed + view.dilation * (aa + bb) + view.dilation * view.dilation;
    p.own = crossed + view.own * (aa + bb) + view.own * view.own;
    return p;
}

}  // namespace GSYN_VARIANT
}  // namespace gsyn

// A stand-in for CHAI3D's vector: the calls that the effect and its program make, and no more.
#pragma once

namespace chai3d {

struct cVector3d {
    cVector3d(double a_x, double a_y, double a_z) : m_data{a_x, a_y, a_z} {}
    double x() const { return m_data[0]; }
    double y() const { return m_data[1]; }
    double z() const { return m_data[2]; }
    void set(const double& a_x, const double& a_y, const double& a_z) { *this = cVector3d(a_x, a_y, a_z); }
    void zero() { set(0.0, 0.0, 0.0); }

    double m_data[3];
};

}  // namespace chai3d

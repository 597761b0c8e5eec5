// The few declarations of CHAI3D 3.3 that docs/examples/chai3d_guard.cpp uses.
#pragma once
#include <memory>
namespace chai3d {
class cVector3d {
public:
    cVector3d() : z_(0.0) {}
    cVector3d(double, double, double z) : z_(z) {}
    double z() const { return z_; }

private:
    double z_;
};
struct cHapticDeviceInfo {
    double m_maxLinearStiffness, m_maxLinearDamping;
};
class cGenericHapticDevice {
public:
    virtual ~cGenericHapticDevice() {}
    cHapticDeviceInfo getSpecifications() { return cHapticDeviceInfo(); }
    virtual bool getPosition(cVector3d&) { return true; }
    virtual bool getLinearVelocity(cVector3d&) { return true; }
    bool setForce(const cVector3d&) { return true; }
};
typedef std::shared_ptr<cGenericHapticDevice> cGenericHapticDevicePtr;
}  // namespace chai3d

// A stand-in for CHAI3D's base class of effects, with the signatures of releases 3.2 and 3.3.
#pragma once
#include "math/CVector3d.h"

namespace chai3d {

class cGenericObject;

class cGenericEffect {
  public:
    explicit cGenericEffect(cGenericObject* a_parent) : m_parent(a_parent) {}
    virtual ~cGenericEffect() {}
    virtual bool computeForce(const cVector3d&, const cVector3d&, const unsigned int&, cVector3d& a_reactionForce) {
        a_reactionForce.zero();
        return false;
    }

    cGenericObject* m_parent;
};

}  // namespace chai3d

// osg_picture: draws a file as OSG's viewer does (headlight, no culling of small features), with the first camera of
// `terrane fly --settle`: field of view 60 degrees along the longer side, looking at the centre of the bounding sphere.
// usage: osg_picture IN OUT.png [WxH] [heading_deg,pitch_deg,range_m] [RRGGBB] [frames]   (needs an X display: xvfb-run)
// Range 0 stands for 2.2 radii. Later frames show animations and particles at frames / 30 s.
#include "common.h"
#include <osg/GraphicsContext>
#include <osgDB/ReadFile>
#include <osgDB/WriteFile>
#include <osgViewer/Viewer>

struct Shot : osg::Camera::DrawCallback
{
    mutable osg::ref_ptr<osg::Image> image = new osg::Image;
    int w, h;
    void operator()(osg::RenderInfo&) const override { image->readPixels(0, 0, w, h, GL_RGB, GL_UNSIGNED_BYTE); }
};

int main(int argc, char** argv)
{
    if (argc < 3) { fprintf(stderr, "usage: osg_picture IN OUT.png [WxH] [heading,pitch,range] [RRGGBB] [frames]\n"); return 2; }
    int w = 640, h = 480, frames = argc > 6 ? atoi(argv[6]) : 3;
    double heading = 0, pitch = -35, range = 0;
    unsigned colour = 0x808080;
    if (argc > 3) sscanf(argv[3], "%dx%d", &w, &h);
    if (argc > 4) sscanf(argv[4], "%lf,%lf,%lf", &heading, &pitch, &range);
    if (argc > 5) sscanf(argv[5], "%x", &colour);
    osg::ref_ptr<osg::Node> scene = osgDB::readRefNodeFile(argv[1]);
    if (!scene) { fprintf(stderr, "%s: not read\n", argv[1]); return 1; }
    osg::ref_ptr<osg::GraphicsContext::Traits> tr = new osg::GraphicsContext::Traits;
    tr->x = tr->y = 0; tr->width = w; tr->height = h; tr->pbuffer = true; tr->doubleBuffer = false; tr->vsync = false; tr->alpha = 8;
    tr->readDISPLAY(); tr->setUndefinedScreenDetailsToDefaultScreen();
    osg::ref_ptr<osg::GraphicsContext> gc = osg::GraphicsContext::createGraphicsContext(tr.get());
    if (!gc) { fprintf(stderr, "no pbuffer context (DISPLAY?)\n"); return 1; }
    osgViewer::Viewer v;
    osg::Camera* c = v.getCamera();
    c->setGraphicsContext(gc.get()); c->setViewport(0, 0, w, h);
    c->setDrawBuffer(GL_FRONT); c->setReadBuffer(GL_FRONT);
    c->setClearColor(osg::Vec4((colour >> 16 & 255) / 255.0, (colour >> 8 & 255) / 255.0, (colour & 255) / 255.0, 1));
    c->setCullingMode(osg::CullSettings::DEFAULT_CULLING & ~osg::CullSettings::SMALL_FEATURE_CULLING);
    v.setUseConfigureAffinity(false); v.setThreadingModel(osgViewer::ViewerBase::SingleThreaded); v.setSceneData(scene.get());
    osg::ref_ptr<Shot> shot = new Shot; shot->w = w; shot->h = h;
    c->setFinalDrawCallback(shot.get());
    v.realize();
    osg::BoundingSphere b = scene->getBound();
    if (range <= 0) range = 2.2 * b.radius();
    double a = osg::DegreesToRadians(heading), p = osg::DegreesToRadians(pitch);
    osg::Vec3d centre(b.center()), way(sin(a) * cos(p), cos(a) * cos(p), sin(p));
    double along = 60, across = 2 * osg::RadiansToDegrees(atan(tan(osg::DegreesToRadians(along / 2)) * std::min(w, h) / std::max(w, h)));
    c->setViewMatrixAsLookAt(centre - way * range, centre, osg::Vec3d(0, 0, 1));
    c->setProjectionMatrixAsPerspective(w >= h ? across : along, (double)w / h, 0.01 * range, 10 * range);
    for (int i = 0; i < frames; ++i) v.frame(i / 30.0);
    for (int i = 0; i < 600 && (!v.getDatabasePager() || v.getDatabasePager()->requiresUpdateSceneGraph() || v.getDatabasePager()->getFileRequestListSize()); ++i)
        v.frame(frames / 30.0);
    if (!osgDB::writeImageFile(*shot->image, argv[2])) { fprintf(stderr, "%s: not written\n", argv[2]); return 1; }
    printf("{\"bench\":\"osg_picture\",\"center\":[%g,%g,%g],\"radius_m\":%g}\n", centre.x(), centre.y(), centre.z(), (double)b.radius());
    return 0;
}

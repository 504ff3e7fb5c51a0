# Weights from their seeds: many hours. A run that was interrupted goes on where it was.
#   make weights       the steps on six towns and parks, from which the others begin
#   make equal         pixloc, d2net and objconnect on the same places over the year
#   make further       what the project ships as objconnect; for a GPU, like the next two
#   make further-pixloc, make full-width
#                      what docs/evidence/results.md compares with it
# PHOTOS, if given, is a folder of plain aerial photographs.
W := runs/weights
.PHONY: weights equal further further-pixloc full-width

# Files that training makes and needs. A place is called PRESET-SEED.
learned = $(W)/$(1)/weights.safetensors
rendered = $(1:%=$(W)/%/scene.json)
mapped = $(1:%=$(W)/%/map/points3D.bin)
season = $(addprefix season-,$(1))
changed = $(addprefix changed-,$(1))
# Recipes. `train`: method, places, configuration, weights to begin with (may be empty), more options.
data = $(1:%=--data $(W)/%)
train = $(BIN)/objconnect train $(1) $(call data,$(2)) --config train/$(3) $(if $(4),--set weights=$(4)) \
  $(5) --out $(@D)
photographs = $(if $(PHOTOS),--set 'photographs=[$(PHOTOS)]')
# `graph`: the graph over objects, on maps and queries of places, with the detector among some weights.
define graph
mkdir -p $(@D)
$(BIN)/python -m objconnect.network.constellation_training $(1:%=$(W)/%) --weights $(2) --out $@
endef
# `render`: configuration, preset and seed.
render = $(BIN)/objconnect simulate --config train/$(1) --preset $(firstword $(subst -, ,$(2))) \
  --seed $(lastword $(subst -, ,$(2))) --out

$(W)/%/scene.json: | libraries
	$(call render,scene,$*) $(@D)

$(W)/season-%/scene.json: | libraries
	$(call render,$(if $(filter street-%,$*),street,seasons),$*) $(@D)

$(W)/season-%/map/points3D.bin: $(W)/season-%/scene.json
	$(BIN)/objconnect map $(W)/season-$*

$(W)/changed-%/map/points3D.bin: | libraries
	$(call render,changed,$*) $(W)/changed-$*
	$(BIN)/objconnect map $(W)/changed-$*

$(W)/map-%/map/points3D.bin: | libraries
	$(call render,objects,town-$*) $(W)/map-$*
	$(BIN)/objconnect map $(W)/map-$*

# First steps, where nothing changes but the light.
SIX := town-1001 suburb-1011 town-1002 park-1021 town-1003 industrial-1031
NINE := $(SIX) town-1004 town-1005 suburb-1012
# Method, places, configuration and the run to begin with.
first_steps = $(call train,$(1),$(2),$(3),$(if $(4),$(call learned,$(4))),--validation $(W)/town-101 $(photographs))

weights: $(call learned,d2net) $(call learned,objconnect) $(call learned,objconnect-objects) \
  $(call learned,connected) $(call learned,supplement)

$(call learned,pixloc-features): $(call rendered,$(SIX) town-101)
	$(call first_steps,pixloc,$(SIX),pixloc-features,)

$(call learned,pixloc): $(call learned,pixloc-features)
	$(call first_steps,pixloc,$(SIX),pixloc,pixloc-features)

$(call learned,pixloc-further): $(call learned,pixloc)
	$(call first_steps,pixloc,$(SIX),pixloc-further,pixloc)

$(call learned,pixloc-upright): $(call learned,pixloc-further)
	$(call first_steps,pixloc,$(SIX),pixloc-upright,pixloc-further)

$(call learned,d2net): $(call learned,pixloc-upright)
	$(call first_steps,d2net,$(SIX),d2net,pixloc-upright)

$(call learned,objconnect): $(call learned,pixloc-upright) $(call rendered,$(NINE) town-101)
	$(call first_steps,objconnect,$(NINE),objconnect,pixloc-upright)

$(call learned,objconnect-objects): $(call learned,pixloc-upright)
	$(call first_steps,objconnect,$(SIX),objconnect-objects,pixloc-upright)

# Objects: a detector on the network of objconnect, then the graph.
CHANGED := town-1101 park-1121 town-1102 suburb-1111
CONNECTED := $(CHANGED) town-1103 farmland-1141 industrial-1131

$(call learned,objects): $(call learned,objconnect) $(call mapped,$(call changed,$(CHANGED)))
	$(call train,objects,$(call changed,$(CHANGED)),objects-detector,$<)

$(call learned,connected): $(call learned,objects) $(call mapped,$(call changed,$(CONNECTED)))
	$(call graph,$(call changed,$(CONNECTED)),$<)

# Points of small things: places on maps with their photographs.
MAPPED := map-1001 map-1002 map-1003

$(call learned,supplement): $(call mapped,$(MAPPED) map-102)
	$(BIN)/python -m objconnect.mapping.supplement.learning $(MAPPED:%=$(W)/%) --validation $(W)/map-102 --out $@

# Equal terms: the features of objconnect to begin with, the same places over the year from above and along
# streets, the same steps. Objects are learned from above.
SEASONS := town-1201 suburb-1211 park-1221 park-1222 farmland-1241 industrial-1231 street-1251 street-1252
SEASONS_ABOVE := $(filter-out street-%,$(SEASONS))
FEATURES_ALONE := network={segmentation: none, attention: false, object_graph: false, scene_graph: false}

equal: $(call learned,equal-pixloc) $(call learned,equal-d2net) $(call learned,equal-connected)

$(call learned,shared): $(call learned,objconnect)
	$(BIN)/python -m experiments.convert_to_pixloc $< $@

$(W)/equal-%/weights.safetensors: $(call learned,shared) $(call rendered,$(call season,$(SEASONS)))
	$(call train,$*,$(call season,$(SEASONS)),equal,$<,$(if $(filter objconnect,$*),--set '$(FEATURES_ALONE)') $(photographs))

$(call learned,equal-objects): $(call learned,equal-objconnect) $(call rendered,$(call season,$(SEASONS_ABOVE)))
	$(call train,objects,$(call season,$(SEASONS_ABOVE)),objects-detector,$<)

$(call learned,equal-connected): $(call learned,equal-objects) $(call mapped,$(call season,$(SEASONS_ABOVE)))
	$(call graph,$(call season,$(SEASONS_ABOVE)),$<)

# Further: more places, larger pictures. The graph needs maps, and was trained on fewer places.
MORE := $(sort $(SEASONS) town-1202 town-1204 suburb-1212 park-1223 park-1224 park-1225 park-1226 farmland-1242 \
  farmland-1243 farmland-1244 farmland-1245 farmland-1246 industrial-1232 street-1253)
MORE_ABOVE := $(filter-out street-%,$(MORE))
MORE_MAPPED := $(SEASONS_ABOVE) town-1202 park-1223 farmland-1242 farmland-1244 suburb-1212 industrial-1232

further: $(call learned,further-connected)
further-pixloc full-width: %: $(W)/%/weights.safetensors

$(call learned,further-pixloc): $(call learned,equal-pixloc) $(call rendered,$(call season,$(MORE)))
	$(call train,pixloc,$(call season,$(MORE)),further,$<,$(photographs))

$(call learned,further-objconnect): $(call learned,equal-connected) $(call rendered,$(call season,$(MORE)))
	$(call train,objconnect,$(call season,$(MORE)),further,$<,$(photographs))

$(call learned,full-width): $(call rendered,$(call season,$(MORE)))
	$(call train,objconnect,$(call season,$(MORE)),full-width,,$(photographs))

$(call learned,further-objects): $(call learned,further-objconnect)
	$(call train,objects,$(call season,$(MORE_ABOVE)),objects-detector,$<,--set batch=8)

$(call learned,further-connected): $(call learned,further-objects) $(call mapped,$(call season,$(MORE_MAPPED)))
	$(call graph,$(call season,$(MORE_MAPPED)),$<)

MODULE Spots
  ! taught 2019-03-11
  LOCAL CONST robtarget pHome:=<10|gun|fixture>;
  LOCAL CONST robtarget p10:=<11|gun|fixture>;
  LOCAL CONST robtarget p20:=<12|gun|fixture>;
  LOCAL CONST robtarget p30:=<13|gun|fixture>;
  PERS gundata g1:=["",1,0,0.1,0.1,0.05,0.5,5];
  PERS spotdata sp10:=[1,3500,3,0.2];
  PROC Weld()
    MoveJ pHome,v1000,z50,gun\WObj:=fixture;
    SpotL p10,vmax,g1,sp10,gun\WObj:=fixture;
    MoveC p20,p30,v300,z5,gun\WObj:=fixture;
    MoveL <14|gun|wobj0>,v500,z50,gun;
    MoveJDO pHome,v1000,fine,gun\WObj:=fixture,doDone,1;
  ENDPROC
ENDMODULE
